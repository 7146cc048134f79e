"""The ARL formalism: the rules of interventions and goal changes, the paper's two settings, and a life under them.

`init`, `advance` and `evaluate` are for a training loop of your own (docs/custom_loops.md); the scores of its metrics
are here too.
"""

from earl_jax.metrics.deployed import deployed
from earl_jax.metrics.scores import Scores, deployed_area, lifetime_scores, regret
from earl_jax.protocol.life import ProtocolState, StepResult, advance, evaluate, init, intervene, set_goal
from earl_jax.protocol.rules import Attempt, Protocol, Rules, StepEnd, advance_rules, count_step, reset_where
from earl_jax.protocol.settings import (
    SETTINGS,
    Continuing,
    Deployment,
    Setting,
    setting_of,
    split_setting,
    with_explicit_horizon,
)

__all__ = [
    "SETTINGS",
    "Attempt",
    "Continuing",
    "Deployment",
    "Protocol",
    "ProtocolState",
    "Rules",
    "Scores",
    "Setting",
    "StepEnd",
    "StepResult",
    "advance",
    "advance_rules",
    "count_step",
    "deployed",
    "deployed_area",
    "evaluate",
    "init",
    "intervene",
    "lifetime_scores",
    "regret",
    "reset_where",
    "set_goal",
    "setting_of",
    "split_setting",
    "with_explicit_horizon",
]
