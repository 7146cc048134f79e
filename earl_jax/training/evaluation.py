"""The paper's two evaluations of lanes during training, and the deployed evaluation of a run folder."""

from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from earl_jax.algos import Method
from earl_jax.envs import Env, with_engine, without_budget
from earl_jax.envs.checks import require_result
from earl_jax.envs.starts import EVAL_PAIRS, STARTS, starts_of
from earl_jax.envs.state import all_finite
from earl_jax.errors import InputError
from earl_jax.metrics.continuing import DIVERGED, continuing
from earl_jax.metrics.deployed import deployed
from earl_jax.options.forks import require_jax
from earl_jax.options.jax_settings import package_types
from earl_jax.options.values import EPISODES, SEED, require
from earl_jax.runs.folder import RunFolder
from earl_jax.runs.table import KEYS
from earl_jax.training.loading import load_policies
from earl_jax.training.policy import Policy
from earl_jax.training.state import LaneState, Problem, TrainState


def evaluate_lanes(problem: Problem, method: Method, state: TrainState) -> tuple[TrainState, dict[str, jax.Array]]:
    """Return the state, with a new window begun, and the metrics [N] of the paper's two evaluations and of the life."""
    lanes, metrics = jax.vmap(lambda m, lane: _evaluate_lane(problem, m, lane, state.step))(method, state.lanes)
    return state.replace(lanes=lanes), metrics


def _evaluate_lane(
    problem: Problem, method: Method, lane: LaneState, step: jax.Array
) -> tuple[LaneState, dict[str, jax.Array]]:
    protocol, policy = problem.protocol, Policy.of(problem.env, method, lane)
    metrics = protocol.deployed(without_budget(problem.env), policy, jax.random.fold_in(lane.key, step))
    window, alive, phases = protocol.eval_every, protocol.alive_steps, len(method.phases)
    counters, of_life = continuing(lane.counters, problem.env, lane.env_state, step, window, alive, phases)
    finite = all_finite((lane.agent, lane.method_state, counters.diagnostics))
    metrics |= {**of_life, DIVERGED: (~finite).astype(jnp.int32)}
    metrics |= _own_metrics(method, lane, {*metrics, *KEYS})
    return lane.replace(counters=counters), metrics


def _own_metrics(method: Method, lane: LaneState, taken: set[str]) -> dict[str, jax.Array]:
    """Return the scalars of learner and method; an InputError if one is not a scalar, or its column is `taken`."""
    state = lane.method_state
    of_method = state.get("metrics", {}) if isinstance(state, dict) else getattr(state, "metrics", {})
    if not isinstance(of_method, dict):
        raise InputError(f"metrics in the state of method {method.name!r} must be a dict of scalars")
    own = {**lane.counters.diagnostics, **{f"{method.name}/{name}": value for name, value in of_method.items()}}
    for name, value in own.items():
        if name in taken:
            raise InputError(
                f"{name!r} is a column of every metrics.csv: give this scalar of the learner or the method another name"
            )
        require_result(f"the column {name!r} of metrics.csv", value, (), "number")
    return {name: value + 0 for name, value in own.items()}  # a bool as 0 or 1


@package_types()
def evaluate(
    folder: str | Path,
    episodes: int = 100,
    seed: int = 0,
    engine: str | None = None,
    starts: str = "initial",
    pairs: str | None = None,
) -> dict[str, np.ndarray]:
    """Return `deployed/success` and `deployed/return` [N] of the newest policies in a run folder, on new episodes.

    After training with a budget for help, the episodes are those of the task without help.

    Args:
        folder: a run folder with policies.npz or a checkpoint.
        episodes: the number of greedy episodes of H_E steps for each seed's policy.
        seed: the seed of starts and goals, which are the same for all policies.
        engine: a physics engine to use instead of the run's own.
        starts: `initial` for s0 ~ rho, `uniform` over the whole workspace (figure 4 of the paper), or `wide` for the
            starts of the column `deployed/success_wide`, if the task has them.
        pairs: `random`, or `balanced` to use every pair of start and task goal equally often; by default the
            `eval_pairs` of the run's setting. With other `starts` than `initial`, pairs are always random.

    Raises:
        ValueError: `folder` is not a run folder, it has no policies or damaged ones, or the task has no such starts.
    """
    require_jax()
    if isinstance(folder, Env) or callable(folder):
        own = "earl_jax.protocol.deployed(env, policy, key, horizon, episodes)"
        raise InputError(f"evaluate takes a run folder; a policy of your own is evaluated by {own}")
    require("seed", seed, SEED)
    require("episodes", episodes, EPISODES)
    run = RunFolder.open(folder)
    env = with_engine(run.config.build_task(), engine)
    if pairs is None:
        pairs = run.config.build_setting().eval_pairs if starts == STARTS[0] else EVAL_PAIRS[0]
    starts_of(env, starts, pairs)  # an error before the policies are read
    policies = load_policies(run)

    def evaluate_policy(policy):
        return deployed(env, policy, jax.random.key(seed), env.eval_horizon, episodes, starts, pairs=pairs)

    return {name: np.asarray(values) for name, values in jax.jit(jax.vmap(evaluate_policy))(policies).items()}
