"""The ARL formalism: the rules of interventions and goal changes, and the paper's two settings."""

from earl_jax.protocol.rules import Attempt, Protocol, Rules, StepEnd, advance_rules, reset_where
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
    "Rules",
    "Setting",
    "StepEnd",
    "advance_rules",
    "reset_where",
    "setting_of",
    "split_setting",
    "with_explicit_horizon",
]
