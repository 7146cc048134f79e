"""A task as an agent of another library lives in it: one life with its interventions and goals, or one episode after another."""

import dataclasses
import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from earl_jax.envs import Env, State, make
from earl_jax.protocol import Deployment, Protocol, Setting, setting_of, split_setting

MODES = ("train", "eval")
ATTEMPT_STEPS = 1000
"""Steps after which naive RL gives up a goal that it has not reached (Sharma et al. 2022, section 5.1)."""


class Life(struct.PyTreeNode):
    """A life, or in `eval` mode a row of episodes: the `key` of what is still to be drawn, the `world`, and what was counted.

    int32 `steps` lived, or of this episode; int32 `attempt`: steps since the goal was drawn; int32 `interventions`; bool `held`:
    the goal was set from outside; bool `reached`: in this episode.
    """

    key: jax.Array
    world: State
    steps: jax.Array
    attempt: jax.Array
    interventions: jax.Array
    held: jax.Array
    reached: jax.Array


class Moment(NamedTuple):
    """What a step or a reset led to: `obs [s + g]` and, as scalars, what its receiver may want to know.

    `success`: the step reached the goal that it was made under; `reached`: a step of this episode did; `ended`: the life came to
    its end; `cut`: the episode was over; `fault`: the simulation broke, and the step earned nothing.
    """

    obs: Any
    reward: Any
    success: Any
    reached: Any
    ended: Any
    cut: Any
    fault: Any
    interventions: Any


@dataclasses.dataclass(frozen=True)
class World:
    """`env` under `protocol`: pure functions of one lane, for jit and vmap.

    `train` is one life: a hard intervention every H_T steps, with the protocol's chance, and where the simulation breaks. In a
    deployment setting the task goal changes when it is reached (sparse rewards), after `attempt_steps`, and at interventions, as
    for naive RL; in the continuing one by the clock alone. `eval` is episodes of H_E steps from s0 ~ rho under one goal each,
    which a broken simulation cuts short: the world stays as it was before. A goal set from outside stays until it is given back.
    """

    env: Env
    protocol: Protocol
    mode: str = "train"
    attempt_steps: int = ATTEMPT_STEPS

    def __post_init__(self):
        if self.mode not in MODES:
            raise ValueError(f"mode {self.mode!r} is not one of {', '.join(MODES)}")
        if self.attempt_steps < 1:
            raise ValueError(f"attempt_steps must be at least 1, not {self.attempt_steps}")

    @classmethod
    def of(
        cls,
        task: str | Env,
        lanes: int = 1,
        mode: str = "train",
        setting: str | Setting = Deployment.name,
        attempt_steps: int = ATTEMPT_STEPS,
        **options: Any,
    ) -> "World":
        """Return the world of `task`, a name with its `options` or an `Env`, for so many `lanes`.

        Raises:
            ValueError: an unknown name or option, or options beside an `Env`; the message lists the choices.
        """
        env = _task(task, options)
        env, setting = split_setting(env, setting_of(setting) if isinstance(setting, str) else setting)
        env = setting.wrap(env.for_lanes(lanes))
        return cls(env, setting.protocol(env), mode, attempt_steps)

    @property
    def living(self) -> bool:
        """Whether this is one life rather than episodes."""
        return self.mode == "train"

    def begin(self, seed: jax.Array) -> Life:
        """Return a life at its start, or the first episode, from a `seed`: uint32 []."""
        return self.born(jax.random.key(seed))

    def born(self, key: jax.Array) -> Life:
        """Return what `begin` does, from a typed key."""
        key, start = jax.random.split(key)
        none, false = jnp.zeros((), jnp.int32), jnp.zeros((), bool)
        return Life(key, self.env.reset(start), none, none, none, false, false)

    def renew(self, life: Life) -> Life:
        """Return `life` after a reset: the next episode, or an intervention from outside; a life that had ended begins anew."""
        born = self.born(life.key)
        if not self.living:
            return born
        key, draw, reset = jax.random.split(life.key, 3)
        drawn = life.held | (self.protocol.goal_change == 0)
        goal = jnp.where(drawn, self.env.sample_goal(draw), life.world.info["goal"])
        world = self.env.with_goal(self.env.intervene(reset, life.world), goal)
        touched = life.replace(
            key=key,
            world=world,
            attempt=jnp.zeros_like(life.attempt),
            interventions=life.interventions + 1,
            held=jnp.zeros_like(life.held),
        )
        return chosen(life.world.done > 0, born, touched)

    def first(self, life: Life) -> Moment:
        """Return what is seen of `life` after a reset, when no step has been made."""
        false = jnp.zeros((), bool)
        return Moment(life.world.obs, jnp.zeros(()), false, false, false, false, false, life.interventions)

    def step(self, life: Life, action: jax.Array) -> tuple[Life, Moment]:
        """Return the life and what is seen of it after one control step with `action [a]`."""
        moved = self.env.step(life.world, action)
        fault = self.env.fault(moved)
        success = self.env.success(moved.obs) & ~fault
        life = life.replace(steps=life.steps + 1, reached=life.reached | success)
        if self.living:
            life, cut = self._lived(life, moved, success, fault), jnp.zeros((), bool)
        else:
            life = life.replace(world=chosen(fault, life.world, moved))
            cut = fault | (life.steps >= self.protocol.eval_horizon)
        reward, ended = jnp.where(fault, 0.0, moved.reward), life.world.done > 0
        return life, Moment(life.world.obs, reward, success, life.reached, ended, cut, fault, life.interventions)

    def _lived(self, life: Life, moved: State, success: jax.Array, fault: jax.Array) -> Life:
        key, chance, draw, reset = jax.random.split(life.key, 4)
        env, rules, attempt = self.env, self.protocol.rules, life.attempt + 1
        touched = rules.intervened(life.steps, chance) | fault
        if self.protocol.goal_change:
            over = rules.goal_changes(life.steps)
        else:
            over = touched | (attempt >= self.attempt_steps) | (env.sparse & success)
        over &= ~life.held
        goal = jnp.where(over, env.sample_goal(draw), life.world.info["goal"])
        return life.replace(
            key=key,
            world=env.with_goal(chosen(touched, env.intervene(reset, moved), moved), goal),
            attempt=jnp.where(over, 0, attempt),
            interventions=life.interventions + touched,
        )

    def command(self, life: Life, goal: jax.Array, touched: jax.Array) -> Life:
        """Return `life`, where `touched` under `goal [g]`, which stays until the next command, `draw` or reset."""
        return chosen(touched, self._under(life, goal, True), life)

    def draw(self, life: Life, touched: jax.Array) -> Life:
        """Return `life`, where `touched` under a task goal drawn uniformly, which the world changes again by its own rules."""
        key, draw = jax.random.split(life.key)
        return chosen(touched, self._under(life, self.env.sample_goal(draw), False).replace(key=key), life)

    def _under(self, life: Life, goal: jax.Array, held: bool) -> Life:
        world, attempt = self.env.with_goal(life.world, goal), jnp.zeros_like(life.attempt)
        return life.replace(world=world, attempt=attempt, held=jnp.full_like(life.held, held))

    def advance(self, life: Life, action: jax.Array, renewed: jax.Array) -> tuple[Life, Moment]:
        """Return what `step` does, or where `renewed` the life and what is seen of it after a reset instead."""
        fresh = self.renew(life)
        return chosen(renewed, (fresh, self.first(fresh)), self.step(life, action))

    def advance_on(self, life: Life, action: jax.Array) -> tuple[Life, Moment, Moment]:
        """Return what `step` does, then reset where the episode or the life was over; last, what was seen before that."""
        life, last = self.step(life, action)
        fresh = self.renew(life)
        return *chosen(last.cut | last.ended, (fresh, self.first(fresh)), (life, last)), last

    def restart(self, life: Life, seed: jax.Array, born: jax.Array, touched: jax.Array) -> tuple[Life, Moment]:
        """Return `life` reset where `touched`: from `seed` where it is to be `born` anew, else renewed."""
        life = chosen(touched, chosen(born, self.begin(seed), self.renew(life)), life)
        return life, self.first(life)


def _task(task: str | Env, options: dict[str, Any]) -> Env:
    if isinstance(task, Env):
        if options:
            raise ValueError(
                f"options {', '.join(options)} go with a task's name; this one is built: use dataclasses.replace"
            )
        return task
    known = [field.name for field in dataclasses.fields(make(task))]
    for option in options:
        if option not in known:
            own = "mode, setting, attempt_steps"
            raise ValueError(f"env {task!r} has no option {option!r}; choose from {own}, {', '.join(known)}")
    return make(task, **options)


def chosen(first: jax.Array, one: Any, other: Any) -> Any:
    """Return the tree `one` where `first`, bool [], else `other`."""
    return jax.tree.map(lambda a, b: jnp.where(first, a, b), one, other)


@functools.cache
def compiled(world: World, name: str, lanes: bool = False) -> Callable:
    """Return the function `name` of `world` under jit, for one life or over a leading axis of lanes."""
    function = getattr(world, name)
    return jax.jit(jax.vmap(function) if lanes else function)


def finite(what: str, values: Any, shape: tuple[int, ...]) -> np.ndarray:
    """Return `values` as float32; others than finite ones of `shape` are a ValueError."""
    array = np.asarray(values, np.float32)
    if array.shape != shape or not np.isfinite(array).all():
        raise ValueError(f"{what} must be finite and of shape {shape}, not {array.tolist()}")
    return array


class Camera:
    """Draws worlds of `env`, uint8 [height, width, 3], with a scene that is made when the first is asked for."""

    def __init__(self, env: Env, height: int, width: int):
        self.env, self.size = env, (height, width)
        self._scene: Any = None

    def __call__(self, world: State) -> np.ndarray:
        """Return the picture of one `world`. Raises: as `earl_jax.rendering.scenes.Scene`."""
        from earl_jax.rendering.scenes import Scene

        self._scene = self._scene or Scene(self.env, self.size)
        return self._scene.image(world)

    def close(self) -> None:
        """Give back what the graphics driver holds."""
        if self._scene is not None:
            self._scene.close()
        self._scene = None
