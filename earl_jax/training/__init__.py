"""Training: the training loop, its state, the programs that run it, and their results."""

from earl_jax.assets import list_pretrained as list_pretrained, pretrained_info as pretrained_info
from earl_jax.training.api import resume as resume, train as train
from earl_jax.training.evaluation import evaluate as evaluate
from earl_jax.training.lifetime import lifetime as lifetime
from earl_jax.training.loading import (
    load_lanes as load_lanes,
    load_policies as load_policies,
    load_visits as load_visits,
)
from earl_jax.training.policy import Policy as Policy, pretrained as pretrained, pretrained_env as pretrained_env
from earl_jax.training.result import Result as Result, load as load, select_seed as select_seed
from earl_jax.training.state import Problem as Problem
from earl_jax.training.transitions import load_transitions as load_transitions
