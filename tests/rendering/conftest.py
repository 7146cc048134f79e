"""Fixtures of the rendering tests."""

import pytest

from earl_jax.envs import make
from earl_jax.rendering.scenes import Scene


@pytest.fixture(scope="session")
def graphics():
    """Skip tests that draw on a machine that cannot."""
    try:
        Scene(make("tabletop_organization"), (8, 8)).close()
    except ValueError as error:
        pytest.skip(str(error))
