"""Fixtures of the adapter tests."""

import pytest

from earl_jax.envs import make
from earl_jax.rendering.scenes import Scene


@pytest.fixture(scope="module")
def pictures():
    """Options of small pictures; a machine that cannot draw skips the test."""
    size = {"width": 64, "height": 48}
    try:
        Scene(make("tabletop_organization"), (48, 64)).close()
    except ValueError as error:
        pytest.skip(str(error))
    return {"render_mode": "rgb_array", **size}
