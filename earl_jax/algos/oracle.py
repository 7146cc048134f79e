"""Oracle RL: the episodic reference, which is reset at every success and every H_E steps."""

from typing import ClassVar

from earl_jax.algos.method import Method, Phase


class Oracle(Method):
    """Reset after every episode, for reference.

    Learn with an extrinsic reset at the end of every episode of H_E steps; resets count as interventions.

    Source: Sharma et al. 2022, section 6. Success ends an episode, as in the released wrappers.
    """

    name: ClassVar[str] = "oracle"

    @property
    def phases(self) -> tuple[Phase, ...]:
        return (Phase(resets=True),)
