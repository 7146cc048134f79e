"""RLPD: naive RL with the learner of "reinforcement learning with prior data"."""

from typing import ClassVar

from earl_jax.algos.learner.base import Learner
from earl_jax.algos.learner.sac import SAC
from earl_jax.algos.naive import Naive


class RLPD(Naive):
    """As naive RL, with many critics and demonstrations.

    Act as naive RL does and learn with an ensemble of critics, drawing half of each batch from demonstrations.

    With E = 10 critics with normalised layers, and a random pair M of them for each update, the target is `y = lambda r
    + (1 - d) gamma min_{i in M} Q'_i(x', a')`, without an entropy term; the actor maximises the mean of all E. Every
    step makes `Learner.utd` critic updates, each on a batch of its own, then one of actor and temperature.

    Source: Ball et al. 2023, "Efficient Online Reinforcement Learning with Offline Data" (RLPD), algorithm 1, and its
    released code, with its choices for sparse rewards (no entropy in the target). The paper is about episodes with
    resets; here, phases and goals are those of `Naive`. This class is a preset: every value is an option of `SAC`,
    which all methods accept. Deliberate differences: `utd` is 1 instead of 20, because its updates are sequential and
    expensive (docs/methods.md has the measured cost); a row is drawn from the demonstrations with probability 1/2; the
    release draws exactly half; layers are normalised after the ReLU instead of before; there are two hidden layers as
    in EARL, while the release has three for its sparse tasks (`hidden_sizes`); the random steps are EARL's.
    """

    learner: Learner = SAC(
        timeout_bootstrap=True,
        layer_norm=True,
        demo_share=0.5,
        ensemble=10,
        target_subset=2,
        backup_entropy=False,
    )

    name: ClassVar[str] = "rlpd"
