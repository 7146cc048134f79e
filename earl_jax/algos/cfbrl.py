"""CFBRL: forward-backward RL of one agent that is cloned before its first step, and learns from moved transitions."""

from typing import Any, ClassVar, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from earl_jax.algos.goals import Goals
from earl_jax.algos.learner import sac as sac_lib
from earl_jax.algos.learner.cloning import Demonstrations
from earl_jax.algos.learner.replay import TransitionBatch
from earl_jax.algos.learner.sac import SAC, Agent
from earl_jax.algos.risc import RISC
from earl_jax.envs import Env
from earl_jax.envs.state import tree_where
from earl_jax.options import within

COPIES = 16
"""Transformed copies of each demonstrated step that the cloning before the first step draws from."""


class Steps(NamedTuple):
    """Steps to transform: `state, next_state, later [B, s]`, where `later` is one of the states after them, `goal [B, g]`."""

    state: jax.Array
    next_state: jax.Array
    later: jax.Array
    goal: jax.Array


class CFBRL(RISC):
    """Clone both directions, then live as RISC does, with hindsight goals and transitions moved to other places."""

    sac: SAC = SAC(
        timeout_bootstrap=True,
        layer_norm=True,
        demo_share=0.5,
        random_steps=0,
        initial_temperature=0.1,
        entropy_per_action=-1.0,
        pretrain_steps=4000,
        pretrain_log_std=-3.0,
        cloning=3.0,
        cloning_final=0.3,
        cloning_steps=500_000,
    )
    switch_share: float = struct.field(default=1.0, metadata=within("[0, 1]"))
    hindsight: float = struct.field(default=0.5, metadata=within("[0, 1]"))
    """Share of a batch whose goal is the place of the object in a later state."""
    translated: float = struct.field(default=0.5, metadata=within("[0, 1]"))
    """Share of a batch that is moved by `Env.translation`, where it can be."""

    warmup: float = struct.field(default=20_000.0, metadata=within("[0, 1000000000]"))
    """Steps at the start of a lifetime in which the critics learn, and actor and temperature stay as cloned."""

    patience: float = struct.field(default=0.5, metadata=within("[0, 1]"))
    """Share of H_E after which a phase explores."""
    exploration: float = struct.field(default=0.5, metadata=within("[0, 1]"))
    """Share of the steps after that in which the action is random."""

    name: ClassVar[str] = "cfbrl"
    later_steps: ClassVar[int] = 50

    def relabel(
        self, key: jax.Array, env: Env, goals: Goals, batch: TransitionBatch, phase: jax.Array
    ) -> TransitionBatch:
        assert batch.later is not None
        assert batch.demonstrated is not None
        goal = jnp.asarray(goals.table)[batch.flags.goal]
        steps, changed, to_clone = self.transform(
            key, env, Steps(batch.state, batch.next_state, batch.later, goal), ~batch.flags.no_successor
        )
        obs = jnp.concatenate([steps.next_state, steps.goal], axis=-1)
        return batch._replace(
            state=steps.state,
            next_state=steps.next_state,
            goal=steps.goal,
            reward=jnp.where(changed, env.reward(obs), batch.reward),
            flags=batch.flags._replace(reached=jnp.where(changed, env.success(obs) & env.sparse, batch.flags.reached)),
            demonstrated=batch.demonstrated & to_clone,
        )

    def transform(
        self, key: jax.Array, env: Env, steps: Steps, allowed: jax.Array
    ) -> tuple[Steps, jax.Array, jax.Array]:
        """Return `steps` with hindsight goals and translations where `allowed [B]`, which of them changed, and which
        keep the meaning of their action as a demonstration."""
        hindsight_key, translated_key, offset_key = jax.random.split(key, 3)
        count = allowed.shape
        achieved = env.goal_from(steps.later) is not None
        hindsight = jax.random.bernoulli(hindsight_key, self.hindsight, count) & allowed & achieved & env.sparse
        offset = jax.vmap(env.translation)(jax.random.split(offset_key, len(allowed)), steps.state, steps.next_state)
        offset = jnp.zeros_like(steps.state) if offset is None else offset
        moved = jax.random.bernoulli(translated_key, self.translated, count) & allowed & env.sparse
        moved &= (offset != 0).any(axis=-1)
        offset = jnp.where(moved[:, None], offset, 0.0)
        state, later = steps.state + offset, steps.later + offset
        goal = jnp.where(hindsight[:, None], env.goal_from(later), steps.goal) if achieved else steps.goal
        ahead = ~env.success(jnp.concatenate([state, goal], axis=-1))
        to_clone = jnp.where(hindsight, ahead, ~moved)
        return Steps(state, steps.next_state + offset, later, goal), hindsight | moved, to_clone

    def explores(
        self, key: jax.Array, env: Env, phase: jax.Array, phase_step: jax.Array, method_state: Any
    ) -> jax.Array:
        late = phase_step >= self.patience * env.eval_horizon
        return late & (jax.random.uniform(jax.random.fold_in(key, 1)) < self.exploration)

    def update_agent(self, key: jax.Array, agent: Agent, batch: sac_lib.Batch) -> tuple[Agent, dict[str, jax.Array]]:
        updated, diagnostics = super().update_agent(key, agent, batch)
        assert batch.step is not None
        kept = updated.replace(
            actor=agent.actor,
            log_temperature=agent.log_temperature,
            moments={**agent.moments, "critics": updated.moments["critics"]},
        )
        return tree_where(batch.step < self.warmup, kept, updated), diagnostics

    def pretrain(self, key: jax.Array, env: Env, agent: Agent, demos: Demonstrations | None) -> Agent:
        if demos is not None and self.sac.pretrain_steps:
            demos = self.transformed_demos(jax.random.fold_in(key, 1), env, demos)
        return super().pretrain(key, env, agent, demos)

    def transformed_demos(self, key: jax.Array, env: Env, demos: Demonstrations) -> Demonstrations:
        """Return `demos` as often as copies of them that are transformed where they can be cloned."""
        rows, actions, last, states = _demo_steps(env, self.directions(env))
        index, ends = np.tile(np.arange(len(rows.state)), COPIES), np.tile(last, COPIES)
        later_key, transform_key = jax.random.split(key)
        draw = jax.random.uniform(later_key, index.shape)
        later = states[index + jnp.floor(draw * (ends - index + 1)).astype(jnp.int32)]
        steps = Steps(rows.state[index], rows.next_state[index], later, rows.goal[index])
        new, _, to_clone = self.transform(transform_key, env, steps, jnp.ones(len(index), bool))
        kept = to_clone[:, None]
        obs = jnp.where(
            kept,
            jnp.concatenate([new.state, new.goal], axis=-1),
            jnp.concatenate([steps.state, steps.goal], axis=-1),
        )
        return Demonstrations(obs, actions[index], np.zeros(len(index), int))


def _demo_steps(env: Env, directions: tuple[str, ...]) -> tuple[Steps, np.ndarray, np.ndarray, jax.Array]:
    """Return all demonstrated steps, their actions, the index of the last step of each one's demonstration, and the
    states after them."""
    parts = [env.demos(direction) for direction in directions]
    ends = np.flatnonzero(np.concatenate([part.ends for part in parts]))
    fields = [np.concatenate([getattr(part, name) for part in parts]) for name in ("states", "next_states", "goals")]
    actions = np.concatenate([part.actions for part in parts])
    last = ends[np.searchsorted(ends, np.arange(len(actions)))]
    state, following, goal = map(jnp.asarray, fields)
    return Steps(state, following, following, goal), actions, last, following
