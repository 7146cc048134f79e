"""Oracle RL: the episodic upper reference, reset at every success and every H_E steps."""

from typing import ClassVar

from earl_jax.algos.method import Method


class Oracle(Method):
    """SAC with an extrinsic reset at the end of every episode of H_E steps; resets are counted as interventions.

    Source: Sharma et al. 2022, section 6; that success ends the episode follows the released wrappers.
    """

    name: ClassVar[str] = "oracle"
    resets: ClassVar[bool] = True
