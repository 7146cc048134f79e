"""Trained policies that ship with the package: actors in float16, and the config and scores of the runs they come from.

The files are assets/pretrained/TASK/METHOD.npz and .json. `python -m benchmarks.pretrained RUN` writes them.
"""

import copy
import dataclasses
from typing import Any

import jax
import numpy as np

from earl_jax import assets
from earl_jax.envs import Env
from earl_jax.errors import InputError
from earl_jax.runs.config import RunConfig
from earl_jax.training.policy import Policy

Arrays = dict[str, np.ndarray]


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
