"""The hyper-parameters of the learner: the shared ones of Sharma et al. 2022, appendix, and options beyond them.

Defaults that the paper does not give follow the authors' released TF-Agents code; each field names its source.
"""

from flax import struct

from earl_jax.algos.learner import networks
from earl_jax.errors import InputError
from earl_jax.options.values import COUNT, COUNT_OR_NEVER, LARGEST_INT, within

SOFT_CRITICS = 2
"""The paper's number of critics with the entropy term."""


class SAC(struct.PyTreeNode):
    """Hyper-parameters of the learner; floats are leaves, so lanes of one program can have different values."""

    learning_rate: float = struct.field(default=3e-4, metadata=within("(0, 1]"))
    """Adam's step size for actor, critics and temperature (paper)."""
    discount: float = struct.field(default=0.99, metadata=within("[0, 1)"))
    """gamma (paper)."""
    target_rate: float = struct.field(default=0.005, metadata=within("(0, 1]"))
    """tau of the target critics, which are updated every step (paper)."""
    actor_average_rate: float | None = struct.field(default=None, metadata=within("(0, 1]"))
    """Rate of an exponential moving average of the actor's weights, updated every step, that is deployed in the actor's
    place: evaluations and saved policies are the average's, the life is lived by the actor. None: no average, as in
    EARL. Source: Nikishin et al. 2018, "Improving Stability in Deep Reinforcement Learning with Weight Averaging"."""
    reward_scale: float = struct.field(default=10.0, metadata=within("(0, 1000000]"))
    """Factor on the reward inside the learner only. The paper gives 1. The released configurations of sparse tasks give
    10, which reproduces the published curves (docs/results.md). Training by name uses `Env.reward_scale` instead."""
    initial_temperature: float = struct.field(default=1.0, metadata=within("(0, 1000000]"))
    """alpha at step 0 (released code; not given in the paper)."""
    fixed_temperature: bool = struct.field(pytree_node=False, default=False)
    """Whether alpha stays at `initial_temperature`, as in the first version of SAC (arXiv 1801.01290), which the paper
    cites for its figure 2; that version also learns a state value, which this learner lacks."""
    entropy_per_action: float = struct.field(default=-0.5, metadata=within("[-100, 100]"))
    """Target entropy divided by the action size (released code: -|A|/2; not given in the paper)."""
    timeout_bootstrap: bool = False
    """Whether to bootstrap through the end of a phase that timed out; not in EARL, where every phase end is
    terminal."""
    demo_share: float = struct.field(default=0.0, metadata=within("[0, 1]"))
    """Share of a batch drawn from the demonstrations alone; 0 as in EARL, which samples all transitions uniformly."""
    batch_size: int = struct.field(pytree_node=False, default=256, metadata=within("[1, 1048576]"))
    """Transitions in a gradient step, drawn uniformly with replacement (paper)."""
    hidden_sizes: tuple[int, ...] = struct.field(pytree_node=False, default=(256, 256), metadata=within("[1, 65536]"))
    """Widths of the ReLU layers of actor and critics (paper)."""
    layer_norm: bool = struct.field(pytree_node=False, default=False)
    """Whether to normalise the critics' hidden layers; not in the paper, but in later work (MEDAL, RLPD) for
    stability."""
    ensemble: int = struct.field(pytree_node=False, default=SOFT_CRITICS, metadata=within("[2, 100]"))
    """Number of critics with the entropy term (paper: 2). The actor climbs the minimum of two, the mean of more, as in
    REDQ and RLPD (10)."""
    target_subset: int = struct.field(pytree_node=False, default=SOFT_CRITICS, metadata=within("[1, 100]"))
    """Number of these critics, drawn anew for each update, whose minimum is the target (REDQ, RLPD: 2, or 1)."""
    backup_entropy: bool = struct.field(pytree_node=False, default=True)
    """Whether the target has the entropy term (paper); RLPD omits it on sparse tasks."""
    utd: int = struct.field(pytree_node=False, default=1, metadata=within("[1, 1000]"))
    """Updates of the critics in a step, each on a batch of its own, before the one of actor and temperature (paper: 1;
    RLPD: 20)."""
    cloning: float | None = struct.field(default=None, metadata=within("[0, 1000000]"))
    """Weight, relative to `reward_scale`, of a cloning term in the actor's loss: the mean squared distance of the
    policy's mode to demonstrated actions of the batch. None: no such term, as in EARL."""
    cloning_final: float | None = struct.field(default=None, metadata=within("[0, 1000000]"))
    """That weight at the end of its linear schedule; None: it stays."""
    cloning_start: int = struct.field(pytree_node=False, default=0, metadata=within(COUNT_OR_NEVER))
    """Step of the lifetime at which the schedule begins."""
    cloning_steps: int = struct.field(pytree_node=False, default=300_000, metadata=within(COUNT))
    """Steps of the schedule."""
    pretrain_steps: int = struct.field(pytree_node=False, default=0, metadata=within(COUNT_OR_NEVER))
    """Cloning steps before the first step of the lifetime, each on a batch of demonstrated steps; 0 as in EARL."""
    pretrain_rate: float = struct.field(default=1e-3, metadata=within("(0, 1]"))
    """Adam's step size in these steps."""
    pretrain_log_std: float | None = struct.field(default=None, metadata=within("[-20, 2]"))
    """Log standard deviation of the policy after these steps, with a gradient from then on; None: the one that they
    leave, which the cloning does not fit."""
    replay_capacity: int | None = struct.field(pytree_node=False, default=None, metadata=within(COUNT))
    """Own transitions of a lane that the replay keeps, first in, first out; None: all. The paper gives 20M and 10M, more
    than any of its runs has."""
    random_steps: int = struct.field(pytree_node=False, default=1000, metadata=within(f"[0, {LARGEST_INT}]"))
    """Number of uniformly random actions, without updates, at the start of a lifetime (paper)."""
    precision: str = struct.field(pytree_node=False, default="tf32")
    """Precision of the networks' matrix products: "float32" (on every device), "tf32" (XLA's default: TF32 on NVIDIA
    GPUs, float32 on CPUs) or "bf16" (bfloat16 operands and activations; parameters, sums, losses and Adam stay
    float32)."""

    def __post_init__(self):
        networks.check_precision(self.precision)
        if self.target_subset > self.ensemble:
            raise InputError(
                f"target_subset {self.target_subset} is larger than the ensemble of {self.ensemble} critics"
            )
