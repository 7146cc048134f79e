"""The ARL formalism: the rules of interventions and goal changes, the paper's two settings, and a life under them.

`init`, `advance` and `evaluate` are for a training loop of your own (docs/custom_loops.md); the scores of its metrics
are here too.
"""

from earl_jax.metrics.deployed import deployed as deployed
from earl_jax.metrics.scores import (
    Scores as Scores,
    deployed_area as deployed_area,
    lifetime_scores as lifetime_scores,
    regret as regret,
)
from earl_jax.protocol.life import (
    ProtocolState as ProtocolState,
    StepResult as StepResult,
    advance as advance,
    evaluate as evaluate,
    init as init,
    intervene as intervene,
    set_goal as set_goal,
)
from earl_jax.protocol.rules import (
    Attempt as Attempt,
    Protocol as Protocol,
    Rules as Rules,
    StepEnd as StepEnd,
    advance_rules as advance_rules,
    count_step as count_step,
    reset_where as reset_where,
)
from earl_jax.protocol.settings import (
    SETTINGS as SETTINGS,
    Continuing as Continuing,
    Deployment as Deployment,
    Setting as Setting,
    setting_of as setting_of,
    split_setting as split_setting,
    with_explicit_horizon as with_explicit_horizon,
)
