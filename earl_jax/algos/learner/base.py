"""The interface of a learner, which the training loop, the methods and the policies use.

The package contains two learners, `SAC` and `TD3`. docs/extending.md shows a third in a file of its own.
"""

import abc
from typing import Any, ClassVar, NamedTuple

import jax
from flax import struct

from earl_jax.algos.learner.networks import PRECISIONS
from earl_jax.algos.pytree import OptionsNode
from earl_jax.errors import InputError, require_known
from earl_jax.options.values import COUNT, COUNT_OR_NEVER, LARGEST_INT, within


class Batch(NamedTuple):
    """Transitions to learn from: `obs, next_obs [B, o]`, `action [B, a]`, `reward [B]`, bool `terminal [B]`.

    `demonstrated [B]`, bool, marks demonstrations of the controller's own behaviour, and `step []` is the step of the
    lifetime. If `utd` batches are concatenated, B is `utd * batch_size`.
    """

    obs: jax.Array
    action: jax.Array
    reward: jax.Array
    terminal: jax.Array
    next_obs: jax.Array
    demonstrated: jax.Array | None = None
    step: jax.Array | None = None

    def split(self, count: int) -> "Batch":
        """Return `count` batches of the same size, leaves [count, B / count, ...], without `step`."""
        return jax.tree.map(lambda leaf: leaf.reshape(count, -1, *leaf.shape[1:]), self._replace(step=None))


class Learner(OptionsNode, abc.ABC):
    """An off-policy actor-critic: its options, and pure functions of one agent without a leading axis.

    An agent is a `flax.struct.PyTreeNode` with the field `actor`, the parameters that `act` and `greedy` receive.
    Subclasses define `init`, `act`, `greedy` and `update`, and override other functions if needed. `update` also has to
    implement the options `utd` (see `Batch.split`) and `cloning` (`cloning.cloning_term`), or `__post_init__` has to
    refuse them. Float options are vmappable leaves, so the lanes of one program can have different values.
    """

    learning_rate: float = struct.field(default=3e-4, metadata=within("(0, 1]"))
    """Adam's step size for all networks, including those of the method itself (paper)."""
    discount: float = struct.field(default=0.99, metadata=within("[0, 1)"))
    """gamma (paper)."""
    reward_scale: float = struct.field(default=10.0, metadata=within("(0, 1000000]"))
    """Factor on the reward, inside the learner only. The paper gives 1, the released configurations of sparse tasks 10;
    docs/results.md compares both. Training by name uses `Env.reward_scale` as the default instead."""
    timeout_bootstrap: bool = False
    """Whether to bootstrap through the end of a phase that timed out. In EARL, every end of a phase is terminal."""
    demo_share: float = struct.field(default=0.0, metadata=within("[0, 1]"))
    """Share of a batch drawn from the demonstrations alone; 0 as in EARL, which samples all transitions uniformly."""
    all_demos: bool = struct.field(pytree_node=False, default=False)
    """Whether each controller that has demonstrations gets those of both directions, as every method does in the paper.
    By default it gets only those of its own direction, as in the released configurations."""
    batch_size: int = struct.field(pytree_node=False, default=256, metadata=within("[1, 1048576]"))
    """Transitions in a gradient step, drawn uniformly with replacement (paper)."""
    utd: int = struct.field(pytree_node=False, default=1, metadata=within("[1, 1000]"))
    """Critic updates in a step, each on a batch of its own, before the update of the actor (paper: 1; RLPD: 20)."""
    replay_capacity: int | None = struct.field(pytree_node=False, default=1_000_000, metadata=within(COUNT))
    """Number of a lane's own transitions that the replay keeps for each controller, first in, first out, as in the
    released code; None keeps all. Two controllers share twice the capacity; in the released code each has its own
    replay. The paper gives 20M and 10M, which is more than any of its runs collects; docs/results.md compares both."""
    keep_demos: bool = struct.field(pytree_node=False, default=False)
    """Whether demonstrations stay when the replay is full of own transitions. The released replay evicts them first,
    because they are the oldest. A `demo_share` is drawn from the demonstrations in either case."""
    random_steps: int = struct.field(pytree_node=False, default=1000, metadata=within(f"[0, {LARGEST_INT}]"))
    """Number of uniformly random actions, without updates, at the start of a lifetime (paper)."""
    pretrain_steps: int = struct.field(pytree_node=False, default=0, metadata=within(COUNT_OR_NEVER))
    """Cloning steps before the first step of the lifetime, each on a batch of demonstrated steps; 0 as in EARL."""
    pretrain_rate: float = struct.field(default=1e-3, metadata=within("(0, 1]", pretrain_steps=0))
    """Adam's step size in the cloning steps before the lifetime."""
    cloning: float | None = struct.field(default=None, metadata=within("[0, 1000000]"))
    """Weight, relative to `reward_scale`, of a cloning term in the actor's loss: the mean squared error of the greedy
    action on the demonstrated steps of the batch. None omits the term, as in EARL."""
    cloning_final: float | None = struct.field(default=None, metadata=within("[0, 1000000]", cloning=None))
    """Weight of the cloning term at the end of a linear schedule; None keeps the weight constant."""
    cloning_start: int = struct.field(pytree_node=False, default=0, metadata=within(COUNT_OR_NEVER, cloning_final=None))
    """Step of the lifetime at which the schedule of the cloning weight begins."""
    cloning_steps: int = struct.field(pytree_node=False, default=300_000, metadata=within(COUNT, cloning_final=None))
    """Length of the schedule of the cloning weight, in steps."""

    precision: str = struct.field(pytree_node=False, default="tf32")
    """Precision of the networks' matrix products: "float32" (on every device), "tf32" (XLA's default: TF32 on NVIDIA
    GPUs, float32 on CPUs) or "bf16" (bfloat16 operands and activations; parameters, sums, losses and Adam stay
    float32)."""

    name: ClassVar[str]
    diagnostics: ClassVar[tuple[str, ...]] = ()
    """Names of the scalars that `update` returns, which become columns of metrics.csv."""

    def __post_init__(self):
        require_known("precision", self.precision, PRECISIONS)

    @abc.abstractmethod
    def init(self, key: jax.Array, obs_size: int, action_size: int, entropy_free_pairs: int = 0) -> Any:
        """Return a fresh agent for observations [o] and actions [a].

        `entropy_free_pairs` is the number of additional pairs of critics that are trained without an entropy term,
        which `value` then reads. A learner whose critics have no entropy term needs no additional pairs.
        """

    @abc.abstractmethod
    def act(self, key: jax.Array, actor: Any, obs: jax.Array) -> jax.Array:
        """Return the actions [..., a] in [-1, 1] that the agent takes in its lifetime at `obs [..., o]`."""

    @abc.abstractmethod
    def greedy(self, actor: Any, obs: jax.Array) -> jax.Array:
        """Return greedy actions [..., a] for evaluations at `obs [..., o]`; differentiable in `actor` for cloning."""

    @abc.abstractmethod
    def update(self, key: jax.Array, agent: Any, batch: Batch) -> tuple[Any, dict[str, jax.Array]]:
        """Return the agent after a gradient step on `batch`, and the scalars [] of `diagnostics` by name."""

    def deployed(self, agent: Any) -> Any:
        """Return the actor that evaluations and saved policies use; by default `agent.actor`."""
        return agent.actor

    def with_actor(self, agent: Any, actor: Any) -> Any:
        """Return the fresh `agent` with its actor replaced by `actor`, which was cloned from demonstrations."""
        return agent.replace(actor=actor)

    def value(self, key: jax.Array, agent: Any, obs: jax.Array) -> jax.Array:
        """Return the discounted scaled reward [...] that the agent expects from `obs [..., o]`, without an entropy term.

        Raises:
            ValueError: this learner has no critics without an entropy term.
        """
        raise InputError(f"learner {self.name!r} has no values without an entropy term, which this method needs")
