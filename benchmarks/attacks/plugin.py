"""Tasks and methods of a user that are wrong: numbers that are not finite, and errors in every part of the contract."""

import json
from pathlib import Path

import jax.numpy as jnp

from earl_jax import register_algo, register_env
from earl_jax.algos.naive import Naive
from earl_jax.envs.tabletop import TabletopOrganization

ERRORS = {
    "ValueError": lambda: ValueError("Incompatible shapes for broadcasting: shapes=[(3,), (4,)]"),
    "TypeError": lambda: TypeError("unsupported operand"),
    "KeyError": lambda: KeyError("goal"),
    "ZeroDivisionError": lambda: 1 // 0,
    "OSError": lambda: Path("/nowhere/weights.npz").read_bytes(),
    "JSONDecodeError": lambda: json.loads("{"),
    "AssertionError": lambda: AssertionError("not yet"),
    "RecursionError": lambda: RecursionError("too deep"),
    "UnicodeDecodeError": lambda: b"\xff".decode(),
    "MemoryError": lambda: MemoryError("too much"),
}


def fail(kind: str):
    """Raise the error `kind`."""
    raise ERRORS[kind]()


def nan_reward(name: str, value: float) -> type:
    """Return a dense task whose reward is `value` where one coordinate is larger than another."""

    class Task(TabletopOrganization):
        def reward(self, obs):
            return jnp.where(obs[..., 0] > obs[..., 1], value, -jnp.abs(obs[..., 0]))

    Task.name = name
    return Task


def nan_state(name: str, value: float) -> type:
    """Return a task whose first coordinate becomes `value` whenever it grows."""

    class Task(TabletopOrganization):
        def transition(self, state, action):
            data, vector, metrics = super().transition(state, action)
            return data, jnp.where(vector[0] > state.obs[0], vector.at[0].set(value), vector), metrics

    Task.name = name
    return Task


def erring_task(name: str, part: str, kind: str) -> type:
    """Return a task whose method `part` raises the error `kind`."""

    def erring(self, *arguments):
        fail(kind)

    return type("Erring", (TabletopOrganization,), {part: erring, "name": name})


def erring_method(name: str, part: str, kind: str) -> type:
    """Return a method whose function `part` raises the error `kind`."""

    def erring(self, *arguments):
        fail(kind)

    return type("Erring", (Naive,), {part: erring, "name": name})


class Bonus(Naive):
    """Naive RL with a bonus on every reward, which may be infinite for one seed."""

    bonus: float = 0.0

    name = "bonus"

    def reward(self, env, goals, batch, phase, method_state):
        """Return the reward with the bonus."""
        return super().reward(env, goals, batch, phase, method_state) + self.bonus


def install(task: type | None = None, method: type | None = None) -> None:
    """Register a task and a method under their names, in this process."""
    if task is not None:
        register_env(task.name, task)
    if method is not None:
        register_algo(method.name, method)
