"""Minari datasets of demonstrations and of lives: `demonstrations(task)`, and `write` for any transitions."""

import dataclasses
import warnings
from typing import Any

import gymnasium
import jax.numpy as jnp
import numpy as np
from gymnasium.envs.registration import EnvSpec

from earl_jax.adapters.gymnasium import env_id, register_envs
from earl_jax.assets import Demos, spans
from earl_jax.envs import Env, env_class, list_envs, make
from earl_jax.errors import InputError, optional

minari = optional("minari", "a Minari dataset needs", "minari")


def demonstrations(task: str | Env, direction: str = "forward", dataset: str | None = None) -> Any:
    """Return a new `MinariDataset` of a task's recorded demonstrations, one episode for each, with rewards of `task`.

    An episode terminates if the reward is sparse and the last step reaches the goal; otherwise it is truncated.

    Args:
        task: a task's name, or an `Env`.
        direction: `forward` or `backward`.
        dataset: the dataset's name; by default `earl_jax/TASK/DIRECTION-v0`.

    Raises:
        ValueError: the task has no such demonstrations, or the dataset already exists.
    """
    env = make(task) if isinstance(task, str) else task
    demos = env.demonstrations.load(direction)
    next_obs = jnp.asarray(np.concatenate([demos.next_states, demos.goals], axis=1))
    terminal = demos.ends & np.asarray(env.success(next_obs)) & env.sparse
    demos = demos._replace(rewards=np.asarray(env.reward(next_obs)))
    dataset = dataset or f"earl_jax/{env.name}/{direction}-v0"
    return write(dataset, env, demos, terminal, "script", f"Demonstrations of {env.name}, {direction}")


def write(dataset: str, env: Env, transitions: Demos, terminal: np.ndarray, algorithm: str, description: str) -> Any:
    """Return a new `MinariDataset` named `dataset` of `transitions [T]` on `env`, whose `ends` separate the episodes.

    Observations are those of the task, state and goal [s + g], in one box: a goal need not be a state, so there is no
    dictionary of both. An episode whose last step is `terminal [T]` terminates; the others are truncated. The dataset
    can recover its gymnasium environment (with `eval_env=True` the evaluation episodes), unless `env` is not registered
    or has a budget for help.

    Raises:
        ValueError: the dataset already exists, or its name is not valid.
    """
    obs, next_obs = (
        np.concatenate([states, transitions.goals], axis=1) for states in (transitions.states, transitions.next_states)
    )
    truncated, buffers = transitions.ends & ~terminal, []
    for steps in spans(transitions.ends):
        buffers.append(
            minari.data_collector.EpisodeBuffer(
                observations=np.concatenate([obs[steps], next_obs[steps][-1:]]),
                actions=transitions.actions[steps],
                rewards=transitions.rewards[steps],
                terminations=terminal[steps],
                truncations=truncated[steps],
                infos={},
            )
        )
    _check_name(dataset)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # an author and a link are the user's to add
        return minari.create_dataset_from_buffers(
            dataset,
            buffers,
            **_environments(env),
            observation_space=env.observation_space,
            action_space=env.action_space,
            algorithm_name=algorithm,
            description=description,
        )


def _check_name(dataset: str) -> None:
    """Raise an InputError if a new dataset cannot have this name, before Minari makes a folder."""
    match = minari.dataset.minari_dataset.DATASET_ID_RE.fullmatch(dataset)
    if match is None or match["version"] is None:
        raise InputError(f"{dataset!r} is not a valid name of a Minari dataset, such as earl_jax/door/replay-v0")
    if minari.storage.get_dataset_path(dataset).exists():
        raise InputError(f"the Minari dataset {dataset} already exists; choose another name or version, or delete it")


def _environments(env: Env) -> dict[str, EnvSpec]:
    """Return gymnasium's specifications of `env` for Minari; empty if no gymnasium id stands for it."""
    if env.name not in list_envs() or type(env) is not env_class(env.name):
        return {}
    register_envs()
    changed = {
        field.name: getattr(env, field.name)
        for field in dataclasses.fields(env)
        if getattr(env, field.name) != field.default
    }
    spec = gymnasium.spec(env_id(env.name))
    spec = dataclasses.replace(spec, kwargs={**spec.kwargs, **changed})
    return {"env": spec, "eval_env": dataclasses.replace(spec, kwargs={**spec.kwargs, "mode": "eval"})}
