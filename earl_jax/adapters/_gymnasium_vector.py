"""Many lanes of a task in one jitted program, as gymnasium's vector environment."""

from collections.abc import Sequence
from typing import Any

import jax
import numpy as np
from gymnasium.utils.seeding import np_random
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from earl_jax.adapters._gymnasium_session import GymnasiumSession, draw_seed
from earl_jax.adapters._session import Outputs, Session, checked_array
from earl_jax.envs import Env
from earl_jax.errors import InputError, brief
from earl_jax.options.values import COUNT, require


class ResetFreeVectorEnv(GymnasiumSession, VectorEnv):
    """Many lanes of a task in one jitted program; lane i of `seed` equals `ResetFreeEnv` with `seed + i` step by step.

    Lifetimes are never reset automatically (`AutoresetMode.DISABLED`). Episodes are reset as `autoreset_mode` says: in
    the next step (the default), in the same step with `final_obs` and `final_info`, or not at all. Infos are the same
    as in `ResetFreeEnv`, each with its mask.
    """

    has_lanes = True

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
        """Make `num_envs` lanes with `autoreset_mode`; the other arguments and errors are those of `ResetFreeEnv`."""
        require("num_envs", num_envs, COUNT)
        self.num_envs = num_envs
        self._open(Session.of(task, num_envs, **options), render_mode, width, height)
        env = self.session.env
        self.single_observation_space, self.single_action_space = env.observation_space, env.action_space
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.autoreset_mode = _autoreset_mode(self.session, autoreset_mode)
        self.metadata = {**self.metadata, "autoreset_mode": self.autoreset_mode}
        self._over, self._all = np.zeros(num_envs, bool), np.ones(num_envs, bool)

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict]:
        """Return observations [N, s + g] and infos after a reset of all lanes, or of `options["reset_mask"]` [N].

        Lane i gets the seed `seed + i`, or item i of a list of N seeds; None in the list gives a lane no seed.
        """
        if isinstance(seed, Sequence):
            lane_seeds = seed
            if len(seed) != self.num_envs:
                raise InputError(f"a list of seeds must have one for each of {self.num_envs} lanes, not {brief(seed)}")
        else:
            super().reset(seed=seed)
            lane_seeds = [None if seed is None else seed + lane for lane in range(self.num_envs)]
        options, first = options or {}, self._state is None
        if not isinstance(options, dict) or options.keys() - {"reset_mask"}:
            raise InputError(f"reset takes the option reset_mask only, not {brief(options)}")
        mask = self._mask(options.get("reset_mask", self._all)) | first
        from_seed = mask & [first or lane_seed is not None for lane_seed in lane_seeds]
        generators = [self.np_random if lane_seed is None else np_random(lane_seed)[0] for lane_seed in lane_seeds]
        seeds = np.stack([draw_seed(generator) for generator in generators])
        states = self._call("start", seeds)[0] if first else self._state
        self._state, outputs = self._call("restart", states, seeds, from_seed, mask)
        self._over &= ~mask
        outputs = jax.device_get(outputs)
        return np.array(outputs.obs), self._masked_infos(outputs, mask)

    def _mask(self, lanes: Any) -> np.ndarray:
        mask = np.array(lanes)
        if mask.shape != (self.num_envs,) or mask.dtype != bool:
            raise InputError(f"a mask of lanes must be bool [{self.num_envs}], not {mask.dtype} {list(mask.shape)}")
        return mask

    def step(self, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict]:
        """Return observations [N, s + g], rewards, terminations, truncations [N] and infos after `actions [N, a]`.

        Raises:
            ValueError: the actions have another shape or are not finite.
        """
        actions = checked_array("actions", actions, (self.num_envs, self.session.env.action_size))
        if self.autoreset_mode is AutoresetMode.SAME_STEP:
            self._state, outputs, last = self._call("step_and_reset", self.state, actions)
        elif self.autoreset_mode is AutoresetMode.NEXT_STEP:
            self._state, outputs = self._call("step_or_reset", self.state, actions, self._over)
            last = outputs
        else:
            self._state, outputs = self._call("step", self.state, actions)
            last = outputs
        outputs, last = jax.device_get((outputs, last))
        self._over = last.terminated | last.truncated
        info = self._masked_infos(outputs, self._all)
        if self.autoreset_mode is AutoresetMode.SAME_STEP and self._over.any():
            info |= self._final_infos(last)
        reward = last.reward.astype(np.float64)
        return np.array(outputs.obs), reward, np.array(last.terminated), np.array(last.truncated), info

    def _masked_infos(self, outputs: Outputs, mask: np.ndarray) -> dict[str, np.ndarray]:
        """Return the infos of the lanes in `mask` with zeros elsewhere, and the mask of each info as `_NAME`."""
        masked = {}
        for name, values in self._infos(outputs).items():
            wide_mask = mask.reshape(-1, *[1] * (values.ndim - 1))
            masked |= {name: np.where(wide_mask, values, np.zeros_like(values)), f"_{name}": mask.copy()}
        return masked

    def _final_infos(self, last: Outputs) -> dict[str, Any]:
        """Return the last observations and infos of the episodes that are over, by gymnasium's names."""
        obs = np.full(self.num_envs, None, object)
        for lane in np.flatnonzero(self._over):
            obs[lane] = np.array(last.obs[lane])
        masks = {"_final_obs": self._over.copy(), "_final_info": self._over.copy()}
        return {"final_obs": obs, "final_info": self._masked_infos(last, self._over), **masks}

    def set_goal(self, goals: np.ndarray | None = None, mask: np.ndarray | None = None) -> np.ndarray:
        """Return observations [N, s + g] with `goals [N, g]`, or with drawn goals, set in all lanes or in `mask [N]`.

        `ResetFreeEnv.set_goal` describes goals and errors.
        """
        mask = self._mask(self._all if mask is None else mask)
        return self._change_goal("goals", goals, (self.num_envs, self.session.env.goal_size), mask)

    def render(self) -> tuple[np.ndarray, ...] | None:
        """Return a picture of each lane, uint8 [height, width, 3], or None without a render mode."""
        if self.render_mode is None:
            return None
        env_states = jax.device_get(self.state.env_state)
        lanes = [jax.tree.map(lambda leaf, i=i: leaf[i], env_states) for i in range(self.num_envs)]
        return tuple(map(self._picture, lanes))


def _autoreset_mode(session: Session, mode: AutoresetMode | str | None) -> AutoresetMode:
    choices = [AutoresetMode.DISABLED] if session.is_training else list(AutoresetMode)
    for choice in choices:
        if mode in (None, choice, choice.value):
            return choice
    names = ", ".join(choice.value for choice in choices)
    raise InputError(f"autoreset_mode {mode!r} is not one of {names} in mode {session.mode!r}")
