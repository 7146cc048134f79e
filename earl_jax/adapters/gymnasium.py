"""The tasks as gymnasium environments: `earl_jax/SawyerDoor-v0` and the like, one at a time or many lanes in one program.

Importing this module registers the ids, and `gymnasium.make("earl_jax.adapters.gymnasium:earl_jax/SawyerDoor-v0")` imports it by
itself. Since 1.0 gymnasium loads no plugins unasked.
"""

from collections.abc import Iterable
from typing import Any

import gymnasium
import jax
import numpy as np
from gymnasium.spaces import Box
from gymnasium.utils.seeding import np_random
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from earl_jax.adapters._world import Camera, Life, Moment, World, compiled, finite
from earl_jax.envs import Env, list_envs

FPS = 10
"""Frames a second of a task whose control step has no length in seconds."""
METADATA: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": FPS}


def env_id(name: str) -> str:
    """Return gymnasium's id of the task `name`: `earl_jax/SawyerDoor-v0` for `sawyer_door`."""
    return f"earl_jax/{''.join(part.capitalize() for part in name.split('_'))}-v0"


def register_envs(names: Iterable[str] | None = None) -> None:
    """Register an id for each of the tasks `names`, by default all of `list_envs()`; ids that exist stay as they are.

    Call it again for tasks that `register_env` brought in after this module was imported.
    """
    for name in list_envs() if names is None else names:
        if env_id(name) not in gymnasium.registry:
            entry, vector = f"{__name__}:LifeEnv", f"{__name__}:LifeVectorEnv"
            gymnasium.register(env_id(name), entry, kwargs={"task": name}, vector_entry_point=vector)


class LifeEnv(gymnasium.Env):
    """A task as one life (`mode="train"`) or as evaluation episodes (`mode="eval"`).

    A life is never truncated, and terminated only where a budget for help is spent. Hard interventions happen inside it, every
    H_T steps, and are counted; `reset()` without a seed is one more, `reset(seed=...)` begins another life. The task goal changes
    where it is reached (sparse rewards), else after `attempt_steps`, and at interventions, as for naive RL; with
    `setting="continuing"` by the clock alone. `set_goal` takes the choice over. Episodes start from s0 ~ rho under one goal each
    and are truncated after H_E steps, or where the simulation breaks.

    `info` has the `goal [g]` that is commanded now, `success`: the step reached the goal that it was made under, `interventions`
    so far, and in episodes `is_success`: any step so far was a success.
    """

    metadata = METADATA

    def __init__(
        self, task: str | Env, *, render_mode: str | None = None, width: int = 640, height: int = 480, **options: Any
    ):
        """Make the environment.

        Args:
            task: a name of `list_envs()` or an `Env`.
            render_mode: `rgb_array`, or None for no pictures.
            width: of a picture, in pixels.
            height: of a picture, in pixels.
            options: `mode`; `setting`, `deployment`, `continuing` or an object of `earl_jax.protocol.rules` with interventions and a
                budget of its own; `attempt_steps`; and the task's own, `reward_type`, `physics`, `train_horizon` and so on.

        Raises:
            ValueError: an unknown mode, setting, option or name; the message lists the choices.
        """
        self.world = World.of(task, **options)
        self.observation_space, self.action_space = _spaces(self.world.env)
        self.metadata, self.render_mode = _metadata(self.world.env, render_mode), render_mode
        self._camera = Camera(self.world.env, height, width)
        self._life: Life | None = None

    @property
    def life(self) -> Life:
        """The life as it is now."""
        return _begun(self._life)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[np.ndarray, dict]:
        """Return the first observation [s + g] and info of a life or an episode, or those after an intervention."""
        super().reset(seed=seed)
        if options:
            raise ValueError(f"reset takes no options, not {', '.join(options)}; set_goal chooses a goal")
        if seed is None and self._life is not None:
            self._life = compiled(self.world, "renew")(self._life)
        else:
            self._life = compiled(self.world, "begin")(_drawn(self.np_random))
        obs, *_, info = self._seen(compiled(self.world, "first")(self._life))
        return obs, info

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict]:
        """Return observation [s + g], reward, terminated, truncated and info after one control step with `action [a]`.

        Raises:
            ValueError: the action has another shape or is not finite.
        """
        action = finite("action", action, (self.world.env.action_size,))
        self._life, moment = compiled(self.world, "step")(self.life, action)
        return self._seen(moment)

    def _seen(self, moment: Moment) -> tuple[np.ndarray, float, bool, bool, dict]:
        moment = jax.device_get(moment)
        infos = _info(self.world, moment)
        info = {name: value if name == "goal" else value.item() for name, value in infos.items()}
        return np.array(moment.obs), float(moment.reward), bool(moment.ended), bool(moment.cut), info

    def set_goal(self, goal: np.ndarray | None = None) -> np.ndarray:
        """Return the observation [s + g] under `goal [g]`, which stays until the next `set_goal` or `reset`.

        Without a goal the world draws a task goal, and changes it by its own rules again.

        Raises:
            ValueError: the goal has another shape or is not finite.
        """
        if goal is None:
            self._life = compiled(self.world, "draw")(self.life, True)
        else:
            goal = finite("goal", goal, (self.world.env.goal_size,))
            self._life = compiled(self.world, "command")(self.life, goal, True)
        return np.array(self.life.world.obs)

    def render(self) -> np.ndarray | None:
        """Return a picture of the world, uint8 [height, width, 3], or nothing without a render mode."""
        return None if self.render_mode is None else self._camera(self.life.world)

    def close(self) -> None:
        """Give back what pictures took."""
        self._camera.close()


class LifeVectorEnv(VectorEnv):
    """Many lanes of a task in one jitted program; lane i of a seed is the `LifeEnv` of `seed + i`, step by step.

    Lives are never reset by themselves (`AutoresetMode.DISABLED`). Episodes are by `autoreset_mode`: in the next step (the
    default), in the same step with `final_obs` and `final_info`, or not at all. Infos are those of `LifeEnv`, each with its mask.
    """

    metadata = METADATA

    def __init__(
        self,
        task: str | Env,
        num_envs: int = 1,
        *,
        autoreset_mode: AutoresetMode | str | None = None,
        render_mode: str | None = None,
        width: int = 640,
        height: int = 480,
        **options: Any,
    ):
        """Make `num_envs` lanes that are reset by `autoreset_mode`; the other arguments and errors are those of `LifeEnv`."""
        if num_envs < 1:
            raise ValueError(f"num_envs must be at least 1, not {num_envs}")
        self.num_envs, self.world = num_envs, World.of(task, lanes=num_envs, **options)
        self.single_observation_space, self.single_action_space = _spaces(self.world.env)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.autoreset_mode = _autoreset(self.world, autoreset_mode)
        self.metadata = {**_metadata(self.world.env, render_mode), "autoreset_mode": self.autoreset_mode}
        self.render_mode, self._camera = render_mode, Camera(self.world.env, height, width)
        self._lives: Life | None = None
        self._over = np.zeros(num_envs, bool)

    @property
    def lives(self) -> Life:
        """All lanes as they are now, with a leading axis [N]."""
        return _begun(self._lives)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[np.ndarray, dict]:
        """Return observations [N, s + g] and infos after a reset of all lanes, or of those in `options["reset_mask"]`."""
        super().reset(seed=seed)
        mask = self._mask(options) | (self._lives is None)
        born = mask & (self._lives is None or seed is not None)
        sources = [self.np_random if seed is None else np_random(seed + i)[0] for i in range(self.num_envs)]
        drawn = np.stack([_drawn(source) for source in sources])
        lives = compiled(self.world, "begin", True)(drawn) if self._lives is None else self._lives
        self._lives, moment = compiled(self.world, "restart", True)(lives, drawn, born, mask)
        self._over &= ~mask
        moment = jax.device_get(moment)
        return np.array(moment.obs), self._infos(moment, mask)

    def _mask(self, options: dict[str, Any] | None) -> np.ndarray:
        options = {"reset_mask": np.ones(self.num_envs, bool), **(options or {})}
        mask = np.array(options.pop("reset_mask"))
        if options:
            raise ValueError(f"reset has no option {', '.join(options)}, only reset_mask")
        if mask.shape != (self.num_envs,) or mask.dtype != bool:
            raise ValueError(f"a mask of lanes is bool [{self.num_envs}], not {mask.dtype} {list(mask.shape)}")
        return mask

    def step(self, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict]:
        """Return observations [N, s + g], rewards, terminations, truncations [N] and infos after `actions [N, a]`.

        Raises:
            ValueError: the actions have another shape or are not finite.
        """
        actions = finite("actions", actions, (self.num_envs, self.world.env.action_size))
        if self.autoreset_mode is AutoresetMode.SAME_STEP:
            self._lives, moment, last = compiled(self.world, "advance_on", True)(self.lives, actions)
        elif self.autoreset_mode is AutoresetMode.NEXT_STEP:
            self._lives, moment = compiled(self.world, "advance", True)(self.lives, actions, self._over)
            last = moment
        else:
            self._lives, moment = compiled(self.world, "step", True)(self.lives, actions)
            last = moment
        moment, last = jax.device_get((moment, last))
        self._over = last.ended | last.cut
        infos = self._infos(moment, np.ones(self.num_envs, bool))
        if self.autoreset_mode is AutoresetMode.SAME_STEP and self._over.any():
            infos |= self._finals(last)
        reward = last.reward.astype(np.float64)
        return np.array(moment.obs), reward, np.array(last.ended), np.array(last.cut), infos

    def _infos(self, moment: Moment, mask: np.ndarray) -> dict[str, np.ndarray]:
        infos = {}
        for name, values in _info(self.world, moment).items():
            there = mask.reshape(-1, *[1] * (values.ndim - 1))
            infos |= {name: np.where(there, values, np.zeros_like(values)), f"_{name}": mask.copy()}
        return infos

    def _finals(self, last: Moment) -> dict[str, Any]:
        """Return what was seen at the end of the episodes that are over, by gymnasium's names."""
        obs = np.full(self.num_envs, None, object)
        for lane in np.flatnonzero(self._over):
            obs[lane] = np.array(last.obs[lane])
        masks = {"_final_obs": self._over.copy(), "_final_info": self._over.copy()}
        return {"final_obs": obs, "final_info": self._infos(last, self._over), **masks}

    def set_goal(self, goals: np.ndarray | None = None, mask: np.ndarray | None = None) -> np.ndarray:
        """Return observations [N, s + g] under `goals [N, g]`, or drawn ones, in all lanes or where `mask [N]`; see `LifeEnv`."""
        mask = self._mask(None if mask is None else {"reset_mask": mask})
        if goals is None:
            self._lives = compiled(self.world, "draw", True)(self.lives, mask)
        else:
            goals = finite("goals", goals, (self.num_envs, self.world.env.goal_size))
            self._lives = compiled(self.world, "command", True)(self.lives, goals, mask)
        return np.array(self.lives.world.obs)

    def render(self) -> tuple[np.ndarray, ...] | None:
        """Return a picture of each lane, uint8 [height, width, 3], or nothing without a render mode."""
        if self.render_mode is None:
            return None
        worlds = jax.device_get(self.lives.world)
        lanes = [jax.tree.map(lambda leaf, i=i: leaf[i], worlds) for i in range(self.num_envs)]
        return tuple(map(self._camera, lanes))

    def close_extras(self, **_: Any) -> None:
        """Give back what pictures took."""
        self._camera.close()


def _begun(life: Life | None) -> Life:
    if life is None:
        raise gymnasium.error.ResetNeeded("call reset() first")
    return life


def _drawn(source: np.random.Generator) -> np.uint32:
    return source.integers(2**32, dtype=np.uint32)


def _info(world: World, moment: Moment) -> dict[str, np.ndarray]:
    """Return the infos of one lane or of all."""
    goal = np.array(moment.obs[..., world.env.state_size :])
    counts = {"success": np.array(moment.success), "interventions": np.array(moment.interventions, np.int64)}
    return {"goal": goal, **counts, **({} if world.living else {"is_success": np.array(moment.reached)})}


def _spaces(env: Env) -> tuple[Box, Box]:
    """Return the observation and the action space of one lane; nothing says how far a state can go."""
    return Box(-np.inf, np.inf, (env.obs_size,), np.float32), Box(-1.0, 1.0, (env.action_size,), np.float32)


def _metadata(env: Env, render_mode: str | None) -> dict[str, Any]:
    modes = METADATA["render_modes"]
    if render_mode not in (None, *modes):
        raise ValueError(f"render_mode {render_mode!r} is not one of None, {', '.join(modes)}")
    seconds = getattr(getattr(env, "task", env), "control_step", 1 / FPS)
    return {"render_modes": modes, "render_fps": round(1 / seconds)}


def _autoreset(world: World, mode: AutoresetMode | str | None) -> AutoresetMode:
    choices = [AutoresetMode.DISABLED] if world.living else list(AutoresetMode)
    for choice in choices:
        if mode in (None, choice, choice.value):
            return choice
    names = ", ".join(choice.value for choice in choices)
    raise ValueError(f"autoreset_mode {mode!r} is not one of {names} in mode {world.mode!r}")


register_envs()
