"""MuJoCo behind one interface: a step maps an integration state to the next one, on any of three engines.

MuJoCo is imported lazily, so that kinematic tasks train on a machine without it.
"""

from earl_jax.physics.engine_choice import EngineCost, fastest_engine, resolve_engine
from earl_jax.physics.models import load_model, mujoco_data
from earl_jax.physics.simulator import Simulator
from earl_jax.physics.state import Actuator, PendingStep, PhysicsState

__all__ = [
    "Actuator",
    "EngineCost",
    "PendingStep",
    "PhysicsState",
    "Simulator",
    "fastest_engine",
    "load_model",
    "mujoco_data",
    "resolve_engine",
]
