"""Actors and their episodes: a policy, a scripted expert, replayed demonstrations or random actions in a task."""

import functools
import operator
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from earl_jax import assets
from earl_jax.envs import Env, State, TaskDemos, chosen_engine, list_envs, make, with_engine
from earl_jax.errors import InputError, brief, require_known
from earl_jax.options.seeds import lane_of
from earl_jax.options.values import SEED, require
from earl_jax.rendering.scenes import view_of
from earl_jax.runs.contents import is_run
from earl_jax.runs.folder import RunFolder
from earl_jax.training import Policy, load_policies, pretrained, pretrained_env, select_seed

ACTINGS = ("policy", "expert", "demos", "random")
"""The newest policy of a run or a trained one that ships, the task's scripted expert, the shipped demonstrations replayed,
or random actions."""
SECONDS_AFTER_GOAL = 0.6
"""Seconds for which an episode goes on after its goal is reached."""

EpisodeStart = tuple[State, np.ndarray]
"""The first state of an episode, and its planned actions [n, a]; n is the length of the episode."""


class Episode(NamedTuple):
    """States [n] from the start on, as NumPy arrays.

    `last` is the step that reached the goal if it was `reached`, or else the last step.
    """

    states: State
    last: int
    reached: bool

    def at(self, step: int) -> State:
        """Return the unbatched state after `step` steps."""
        return jax.tree.map(operator.itemgetter(step), self.states)


class Actor(NamedTuple):
    """Acts in `env`; `acting` is one of `ACTINGS`.

    `start(number)` returns the start of an episode and its planned actions. These are executed in turn, unless
    `act(obs [o])` returns the actions [a].
    """

    env: Env
    acting: str
    start: Callable[[int], EpisodeStart]
    act: Callable[[jax.Array], jax.Array] | None = None


def actor_of(
    source: str | Path, acting: str | None = None, seed: int | None = None, method: str | None = None
) -> Actor:
    """Return the actor of `source`, a run folder or a task; physics runs on the C engine. Errors as `render`.

    `method` names a trained policy of a task that ships with the package.
    """
    if seed is not None:
        require("seed", seed, SEED)
    if acting is not None:
        require_known("acting", acting, ACTINGS)
    if not isinstance(method, str | None):
        own = "draw the states of a policy of your own with earl_jax.rendering.Scene"
        raise InputError(f"policy is the name of a method, not {brief(method)}; {own}")
    if not is_run(source) and str(source) not in list_envs():
        raise InputError(f"{source} is neither a run folder nor a task; the tasks are {', '.join(list_envs())}")
    if method is not None and acting not in (None, "policy"):
        raise InputError(f"the policy {method!r} and acting {acting!r} exclude each other: leave out one")
    env, policy = _env_and_policy(source, seed, method)
    actors = _actors(env if chosen_engine(env) == "kinematic" else with_engine(env, "c"), policy, seed or 0)
    chosen = acting or next(iter(actors))
    if chosen not in actors:
        raise InputError(f"{source} has no acting {acting!r}; choose from {', '.join(actors)}")
    return actors[chosen]


def _env_and_policy(source: str | Path, seed: int | None, method: str | None) -> tuple[Env, Policy | None]:
    """Return the environment of `source` and its policy: of a run, or of a `method` that ships; None without either."""
    if not is_run(source):
        if method is None:
            return make(str(source)), None
        return pretrained_env(str(source), method), pretrained(str(source), method)
    if method is not None:
        raise InputError(f"{source} is a run folder, whose own policy acts: leave out the method {method!r}")
    run = RunFolder.open(source)
    lane = lane_of(seed, run.config.seeds, f"in {source}")
    return run.config.build_task(), select_seed(load_policies(run), lane)


def _actors(env: Env, policy: Policy | None, seed: int) -> dict[str, Actor]:
    """Return every possible actor in `env`, by its acting; the first one is the default."""
    no_plan = np.zeros((env.eval_horizon, env.action_size), np.float32)

    def start(number: int) -> EpisodeStart:
        return env.reset(jax.random.fold_in(jax.random.key(seed), number)), no_plan

    def random_start(number: int) -> EpisodeStart:
        actions = np.random.default_rng([seed, number]).uniform(-1, 1, no_plan.shape)
        return start(number)[0], actions.astype(np.float32)

    actors = {} if policy is None else {"policy": Actor(env, "policy", start, policy)}
    if env.demonstrations.expert is not None:
        actors["expert"] = Actor(env, "expert", start, env.demonstrations.expert)
    if env.demonstrations.recorded and env.demonstrations.state_at is not None:
        actors["demos"] = Actor(env, "demos", functools.partial(_demo_start, env.demonstrations, seed))
    actors["random"] = Actor(env, "random", random_start)
    return actors


def _demo_start(recorded: TaskDemos, seed: int, number: int) -> EpisodeStart:
    """Return the start of a forward demonstration, with its actions and zeros up to the length of the longest one."""
    demos = recorded.load("forward")
    assert recorded.state_at is not None
    spans = assets.spans(demos.ends)
    span, longest = spans[(seed + number) % len(spans)], max(span.stop - span.start for span in spans)
    actions = demos.actions[span]
    planned = np.pad(actions, ((0, longest - len(actions)), (0, 0)))
    return recorded.state_at(jnp.asarray(demos.states[span.start]), jnp.asarray(demos.goals[span.start])), planned


def episodes(actor: Actor, life: bool = False) -> Iterator[Episode]:
    """Yield episodes of `actor` without end; each stops `SECONDS_AFTER_GOAL` after it reaches its goal.

    In a `life` each episode goes on from the last state of the one before, and every second goal is an initial state.
    """
    env = actor.env

    @jax.jit
    def rollout(first: State, planned: jax.Array) -> State:
        def step(state: State, action: jax.Array) -> tuple[State, State]:
            next_state = env.step(state, actor.act(state.obs) if actor.act else action)
            return next_state, next_state

        states = jax.lax.scan(step, first, planned)[1]
        return jax.tree.map(lambda start, rest: jnp.concatenate([jnp.asarray(start)[None], rest]), first, states)

    episode = None
    for number in range(2**31):
        first, planned = actor.start(number)
        if life and episode:
            there, back = first.info["goal"], env.initial_states[number // 2 % len(env.initial_states)]
            first = env.with_goal(episode.at(-1), back if number % 2 else there)
        states = jax.device_get(rollout(first, planned))
        successes = np.flatnonzero(states.metrics["success"][1:])
        last = int(successes[0]) + 1 if len(successes) else len(states.reward) - 1
        kept = operator.itemgetter(slice(last + round(SECONDS_AFTER_GOAL / view_of(env).dt) + 1))
        episode = Episode(states=jax.tree.map(kept, states), last=last, reached=len(successes) > 0)
        yield episode
