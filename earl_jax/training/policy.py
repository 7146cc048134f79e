"""A learnt policy as a callable, and the trained policies that ship with the package.

The shipped policies are actors in float16 with the config and the scores of the runs that trained them, in the files
assets/pretrained/TASK/METHOD.npz and .json. `python -m benchmarks.pretrained RUN` writes these files.
"""

import dataclasses
import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from flax.traverse_util import unflatten_dict

from earl_jax import assets
from earl_jax.algos import learner_of
from earl_jax.algos.learner.base import Learner
from earl_jax.algos.method import TASK, Method
from earl_jax.envs import Env, without_budget
from earl_jax.envs.checks import require_result
from earl_jax.errors import InputError
from earl_jax.options.forks import require_jax
from earl_jax.options.jax_settings import package_types
from earl_jax.options.seeds import lane_of
from earl_jax.runs.config import RunConfig
from earl_jax.runs.numpy_policy import FULL_BUDGET, NumpyPolicy
from earl_jax.training.state import LaneState

PROBES = 16
"""Random observations at which a policy and its NumPy form are compared."""
_greedy = jax.jit(lambda learner, actor, obs: learner.greedy(actor, obs))


class Policy(struct.PyTreeNode, eq=False):
    """The greedy task policy of one lane: `policy(obs [..., o]) -> action [..., a]`, pure, works under jit and vmap.

    Observations and actions are those of the plain task, even after training with a budget for help. In that case the
    actor receives a full budget at index `budget_at` of its observation, and its action component for help is dropped.
    """

    learner: Learner
    actor: Any
    obs_size: int = struct.field(pytree_node=False)
    action_size: int = struct.field(pytree_node=False)
    budget_at: int | None = struct.field(pytree_node=False, default=None)

    @classmethod
    def of(cls, env: Env, method: Method, lane: LaneState) -> "Policy":
        """Return the policy of one lane (no lane axis) of `method` on `env`."""
        agent = jax.tree.map(lambda leaf: leaf[method.phases[TASK].controller], lane.agent)
        return cls.of_actor(env, method.learner, method.learner.deployed(agent))

    @classmethod
    def of_actor(cls, env: Env, learner: Learner, actor: Any) -> "Policy":
        """Return the policy of an `actor` that was trained on `env`."""
        plain = without_budget(env)
        budget_at = None if plain is env else plain.state_size
        return cls(learner, actor, plain.observation_size, plain.action_size, budget_at)

    def __repr__(self) -> str:
        lanes = list(np.shape(getattr(self.learner, "discount", 0.0)))
        sizes = f"obs [..., {self.obs_size}] -> action [..., {self.action_size}]"
        layers = "-".join(map(str, getattr(self.learner, "hidden_sizes", ())))
        return f"Policy{lanes or ''}({', '.join(filter(None, [sizes, type(self.learner).__name__, layers]))})"

    @package_types()
    def __call__(self, obs: jax.typing.ArrayLike) -> jax.Array:
        """Return the greedy action [..., a] at `obs [..., o]`.

        Raises:
            ValueError: `obs`, or the action of the learner, has a wrong size, or this is a stack of policies.
        """
        require_jax()
        self._require_single()
        obs = jnp.asarray(obs, jnp.float32)
        if obs.shape[-1:] != (self.obs_size,):
            raise InputError(f"obs has shape {obs.shape}, this policy takes (..., {self.obs_size})")
        if self.budget_at is not None:
            obs = jnp.insert(obs, self.budget_at, FULL_BUDGET, axis=-1)
        action, size = _greedy(self.learner, self.actor, obs), self.action_size + (self.budget_at is not None)
        require_result(f"what greedy of {self.learner.name!r} returns", action, (*obs.shape[:-1], size), "number")
        return action[..., : self.action_size]

    def _require_single(self) -> None:
        if np.shape(self.learner.discount):
            raise InputError("this is a stack of policies: use jax.vmap, or select_seed(policies, lane)")

    def numpy(self) -> NumpyPolicy:
        """Return this policy in plain NumPy; it can act, be saved and be loaded without jax.

        Raises:
            ValueError: this is a stack of policies, or a comparison shows that the learner's greedy action is not the
                tanh of the first outputs of a ReLU network.
        """
        self._require_single()
        layers = self.actor.get("params", {}) if isinstance(self.actor, dict) else {}
        names = [f"hidden_{number}" for number in range(len(layers))]
        if names and set(layers) == set(names) and np.ndim(layers[names[0]]["bias"]) == 1:
            pairs = [(np.array(layers[name]["kernel"]), np.array(layers[name]["bias"])) for name in names]
            policy = NumpyPolicy(tuple(pairs), self.action_size, self.budget_at)
            obs = np.random.default_rng(0).normal(size=(PROBES, self.obs_size)).astype(np.float32)
            exact = self.replace(learner=self.learner.replace(precision="float32"))
            if np.allclose(policy(obs), exact(obs), atol=1e-4, equal_nan=True):
                return dataclasses.replace(policy, bf16=self.learner.precision == "bf16")
        raise InputError(
            f"this policy of the learner {self.learner.name!r} has no NumPy form: its greedy action is not "
            "the tanh of the first outputs of a ReLU network"
        )


@functools.partial(jax.jit, static_argnames="env")
def policies_of(env: Env, method: Method, lanes: LaneState) -> Policy:
    """Return the task policies of all `lanes` of `method` on `env`, one policy with leaves [N]."""
    return jax.vmap(functools.partial(Policy.of, env))(method, lanes)


def pretrained(task: str, method: str, seed: int | None = None) -> Policy:
    """Return the trained policy of `method` on `task`: `policy(obs [..., o]) -> action [..., a]`, works under jit and vmap.

    `seed` is one of the seeds whose policies ship (`pretrained_info(task, method)["seeds"]`), by default the first.
    Weights are stored as float16 and used as float32.

    Raises:
        ValueError: no such policy ships; the message lists the choices.
    """
    info, arrays = assets.pretrained(task, method)
    lane = lane_of(seed, info["seeds"], f"of {method} on {task} ships")
    config = RunConfig.from_stored(info["config"])
    actor = actor_of_arrays({name: array[lane] for name, array in arrays.items()})
    return Policy.of_actor(config.build_env(), learner_of(config.options), actor)


def pretrained_env(task: str, method: str) -> Env:
    """Return the task with the options of the run that trained the policy. Errors as `pretrained`."""
    return RunConfig.from_stored(assets.pretrained_info(task, method)["config"]).build_env()


def actor_of_arrays(arrays: dict[str, np.ndarray]) -> Any:
    """Return the actor with the parameters `arrays`, named `hidden_0.kernel` and so on, as float32."""
    require_jax()
    leaves = {name: jnp.asarray(array, jnp.float32) for name, array in arrays.items()}
    return {"params": unflatten_dict(leaves, sep=".")}
