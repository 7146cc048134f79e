"""What a task knows about its transitions beyond one goal and one place: goals from states, and translations."""

import jax


class Relabelled:
    """Goals that later states met, and the translations under which the dynamics of an `Env` are the same."""

    def goal_from(self, state: jax.Array) -> jax.Array | None:
        """Return the goals [..., g] that ask for the object where it is in `state [..., s]`; None without an object.

        What is not the object is as in the task's first goal.
        """
        del state
        return None

    def translation(self, key: jax.Array, state: jax.Array, next_state: jax.Array) -> jax.Array | None:
        """Return a random vector [s] that can be added to `state [s]` and `next_state [s]` of a transition.

        The same action then leads from one sum to the other. It is 0 for a transition that something fixed takes part
        in, and where the sums would leave the space in which this holds. None: the task has no such symmetry.
        """
        del key, state, next_state
        return None
