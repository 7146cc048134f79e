"""MuJoCo behind one interface: a step maps an integration state to the next one, on any of three engines.

MuJoCo is imported lazily, so that kinematic tasks train on a machine without it.
"""

from earl_jax.physics.engine_choice import (
    EngineCost as EngineCost,
    fastest_engine as fastest_engine,
    resolve_engine as resolve_engine,
)
from earl_jax.physics.models import load_model as load_model, mujoco_data as mujoco_data
from earl_jax.physics.simulator import Simulator as Simulator
from earl_jax.physics.state import Actuator as Actuator, PendingStep as PendingStep, PhysicsState as PhysicsState
