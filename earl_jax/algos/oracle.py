"""Oracle RL: the episodic reference, which is reset at every success and every H_E steps."""

from typing import ClassVar

from earl_jax.algos.method import Method


class Oracle(Method):
    """SAC with an extrinsic reset at the end of every episode of H_E steps; resets count as interventions.

    Source: Sharma et al. 2022, section 6. Success ends an episode, as in the released wrappers.
    """

    name: ClassVar[str] = "oracle"
    resets: ClassVar[bool] = True
