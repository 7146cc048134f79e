"""Training: the loop, its state, the programs that run it, and their results."""

from earl_jax.assets import list_pretrained, pretrained_info
from earl_jax.training.api import resume, split_options, train
from earl_jax.training.evaluation import evaluate
from earl_jax.training.lifetime import lifetime
from earl_jax.training.loading import load_lanes, load_policies, load_visits
from earl_jax.training.policy import Policy, pretrained, pretrained_env
from earl_jax.training.result import Result, load, select_seed
from earl_jax.training.state import Problem
from earl_jax.training.transitions import load_transitions

__all__ = [
    "Policy",
    "Problem",
    "Result",
    "evaluate",
    "lifetime",
    "list_pretrained",
    "load",
    "load_lanes",
    "load_policies",
    "load_transitions",
    "load_visits",
    "pretrained",
    "pretrained_env",
    "pretrained_info",
    "resume",
    "select_seed",
    "split_options",
    "train",
]
