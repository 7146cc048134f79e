"""A learnt policy as a callable, and the trained policies that ship with the package.

Those are actors in float16, with the config and the scores of the runs they come from, in the files
assets/pretrained/TASK/METHOD.npz and .json. `python -m benchmarks.pretrained RUN` writes them.
"""

import copy
import dataclasses
from typing import Any

import jax
import numpy as np
from flax import struct

from earl_jax import assets
from earl_jax.algos.learner import networks, sac
from earl_jax.algos.learner.sac import SAC
from earl_jax.algos.method import TASK, Method
from earl_jax.envs import Env, plain_task
from earl_jax.errors import InputError
from earl_jax.runs.config import RunConfig
from earl_jax.training.state import LaneState

Arrays = dict[str, np.ndarray]
FULL_BUDGET = 1.0
"""The share of the budget for help at which a policy is evaluated, where nothing is charged."""


def plain_actor(env: Env, actor: Any) -> Any:
    """Return the task actor of `env` for `plain_task(env)`: it observes a full budget and has no component for help.

    `actor` has any leading axes. Without a budget, it is returned as it is.
    """
    plain = plain_task(env)
    if plain is env:
        return actor
    return networks.drop_action(networks.fix_input(actor, plain.state_size, FULL_BUDGET), plain.action_size)


class Policy(struct.PyTreeNode, eq=False):
    """The greedy task policy of one lane: `policy(obs [..., o]) -> action [..., a]`, pure, works under jit and vmap.

    Sizes are those of the plain task, also after training with a budget for help (`plain_actor`).
    """

    sac: SAC
    actor: Any
    obs_size: int = struct.field(pytree_node=False)
    action_size: int = struct.field(pytree_node=False)

    @classmethod
    def of(cls, env: Env, method: Method, lane: LaneState) -> "Policy":
        """Return the policy of one lane (no lane axis) of `method` on `env`."""
        actor = plain_actor(env, jax.tree.map(lambda leaf: leaf[TASK], lane.agent.deployed_actor))
        plain = plain_task(env)
        return cls(method.sac, actor, plain.obs_size, plain.action_size)

    def __call__(self, obs: jax.Array) -> jax.Array:
        """Return the greedy action [..., a] at `obs [..., o]`.

        Raises:
            ValueError: `obs` has another size.
        """
        if obs.shape[-1] != self.obs_size:
            raise InputError(f"obs has shape {obs.shape}, this policy takes (..., {self.obs_size})")
        return sac.greedy(self.sac, self.actor, obs, self.action_size)


def pretrained(task: str, method: str, seed: int | None = None) -> Policy:
    """Return the trained policy of `method` on `task`: `policy(obs [..., o]) -> action [..., a]`, works under jit and vmap.

    `seed` is one of the run's seeds that ship (`pretrained_info(task, method)["seeds"]`), by default the first. Weights
    are stored as float16 and used as float32.

    Raises:
        ValueError: no such policy ships; the message lists the choices.
    """
    info, arrays = pretrained_info(task, method), assets.pretrained(task, method)[1]
    seeds = info["seeds"]
    if seed is not None and seed not in seeds:
        raise InputError(f"no seed {seed!r} of {method} on {task} ships; choose from {', '.join(map(str, seeds))}")
    lane = 0 if seed is None else seeds.index(seed)
    config = _config(info)
    env, actor = config.build_env(), actor_of_arrays({name: array[lane] for name, array in arrays.items()})
    return Policy(config.build_method().sac, actor, env.obs_size, env.action_size)


def pretrained_env(task: str, method: str) -> Env:
    """Return the task with the options of the run that trained the policy. Errors as `pretrained`."""
    return _config(pretrained_info(task, method)).build_env()


def pretrained_info(task: str, method: str) -> dict[str, Any]:
    """Return what is known of a trained policy that ships, as plain values.

    `config` is that of the run, with the versions and the commit that it was made with; `step`, the training steps;
    `seeds`, those that ship; `deployed/success` and `deployed/return`, their scores over `episodes` greedy episodes of
    the float16 actors; `run`, the mean of the last `evaluations` evaluations of every seed of the run. Errors as
    `pretrained`.
    """
    return copy.deepcopy(assets.pretrained(task, method)[0])


def list_pretrained() -> dict[str, list[str]]:
    """Return the methods of which trained policies ship, by task, both sorted."""
    return assets.list_pretrained()


def arrays_of_actor(actor: Any) -> Arrays:
    """Return the parameters of an actor, leaves [...], as float16 arrays by layer and kind: `hidden_0.kernel` and so on.

    Raises:
        ValueError: a weight is not finite in float16.
    """
    layers = actor["params"]
    with np.errstate(over="ignore"):  # reported below
        arrays = {
            f"{layer}.{kind}": np.asarray(leaf, np.float16) for layer in layers for kind, leaf in layers[layer].items()
        }
    broken = [name for name, array in arrays.items() if not np.isfinite(array).all()]
    if broken:
        raise InputError(f"{broken[0]} has a weight that is not finite in float16")
    return arrays


def actor_of_arrays(arrays: Arrays) -> Any:
    """Return the actor with float32 parameters whose `arrays_of_actor` are `arrays`."""
    layers: dict[str, dict[str, jax.Array]] = {}
    for name, array in arrays.items():
        layer, _, kind = name.partition(".")
        layers.setdefault(layer, {})[kind] = jax.numpy.asarray(array, np.float32)
    return {"params": layers}


def _config(info: dict[str, Any]) -> RunConfig:
    fields = {field.name for field in dataclasses.fields(RunConfig)}
    return RunConfig(**{name: value for name, value in info["config"].items() if name in fields})
