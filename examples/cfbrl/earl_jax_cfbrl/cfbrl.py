"""CFBRL: forward-backward RL of one agent, cloned from corrected demonstrations before its first step."""

from typing import Any, ClassVar, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from earl_jax.algos.goals import Goals, later_demonstrated, rescored
from earl_jax.algos.learner.base import Batch, Learner
from earl_jax.algos.learner.cloning import DemoSteps
from earl_jax.algos.learner.replay import TransitionBatch
from earl_jax.algos.learner.sac import SAC
from earl_jax.algos.method import Moment
from earl_jax.algos.risc import RISC
from earl_jax.envs import Env
from earl_jax.envs.state import tree_where
from earl_jax.errors import InputError
from earl_jax.options.values import within
from earl_jax_cfbrl.tasks import knowledge_of

COPIES = 64
"""Transformed copies of each demonstrated step from which the cloning before the first step draws."""
RANDOM_ACTION_REPEAT = 10
"""Steps for which a random action is repeated, so that the exploration gets somewhere."""


class Steps(NamedTuple):
    """Steps to transform: `state, next_state, later [B, s]`, `later` being a state after them, `action`, `goal [B, g]`."""

    state: jax.Array
    action: jax.Array
    next_state: jax.Array
    later: jax.Array
    goal: jax.Array


class CFBRL(RISC):
    """As FBRL with one agent, after cloning the demonstrations.

    Clone both directions before the first step, then alternate phases as FBRL does, with one goal-conditioned agent.

    The actor starts as `BC` does, with little noise, and keeps a cloning term. For `warmup` steps only the critics
    learn. Demonstrated steps are also cloned from other states of the robot, with actions that lead back
    (`Knowledge.correction`). Transitions are learnt from in three forms, on sparse tasks: as they are; with the place of
    the object in a later state as the goal; and moved to another place of the workspace, where the dynamics are the same.
    The cloning uses the second form too, and the third together with it, since then the action keeps its meaning. A
    phase that lasts longer than `patience` is stuck: from then on, blocks of steps repeat a random action.

    Source: this project, 2026. The parts are known: the cloning term (Rajeswaran et al. 2018, DAPG), hindsight goals
    (Andrychowicz et al. 2017, HER), moved transitions (Lin et al. 2020, "Invariant Transform Experience Replay"), half of
    each batch from demonstrations, normalised layers and bootstrapped time-outs (Ball et al. 2023; Patil et al. 2024).
    Corrective labels are those of Ke et al. 2023 ("CCIL"), which takes them from a learnt model of the dynamics.
    Translations and corrections are knowledge of the task (`tasks.KNOWN`) that no method of the paper has;
    `translated=0` and `corrected=0` omit them. Switching is RISC's, and off by default.
    """

    learner: Learner = SAC(
        timeout_bootstrap=True,
        layer_norm=True,
        demo_share=0.5,
        random_steps=0,
        initial_temperature=0.1,
        entropy_per_action=-1.0,
        pretrain_steps=6000,
        pretrain_log_std=-3.0,
        cloning=3.0,
        cloning_final=0.3,
        cloning_steps=500_000,
    )
    switching: bool = struct.field(pytree_node=False, default=False)
    """Whether phases end early as in RISC."""
    hindsight: float = struct.field(default=0.5, metadata=within("[0, 1]"))
    """Share of a batch whose goal is the place of the object in a later state."""
    translated: float = struct.field(default=0.5, metadata=within("[0, 1]"))
    """Share of a batch that is moved by `Knowledge.translation`, where it can be."""
    corrected: float = struct.field(default=0.5, metadata=within("[0, 1]"))
    """Share of the demonstrated steps that start from a state of `Knowledge.correction`, where there is one."""
    warmup: float = struct.field(default=20_000.0, metadata=within("[0, 1000000000]"))
    """Steps at the start of a lifetime in which actor and temperature stay as cloned."""
    learning: bool = struct.field(pytree_node=False, default=True)
    """Whether the agent learns from its life; if not, it stays as cloned, and no update is computed."""
    patience: float = struct.field(default=0.5, metadata=within("[0, 1]"))
    """Share of H_E after which a phase explores."""
    exploration: float = struct.field(default=0.5, metadata=within("[0, 1]"))
    """Share of the steps after that in which the action is random."""

    name: ClassVar[str] = "cfbrl"
    later_steps: ClassVar[int] = 50

    def act(self, key: jax.Array, env: Env, actor: Any, obs: jax.Array, moment: Moment, method_state: Any) -> jax.Array:
        """Return the learner's action [a], or in a stuck phase often a random one, the same for a block of steps."""
        block_key = jax.random.fold_in(jax.random.fold_in(moment.lane_key, moment.step // RANDOM_ACTION_REPEAT), 3)
        stuck = moment.phase_step >= self.patience * env.eval_horizon
        explores = stuck & (jax.random.uniform(jax.random.fold_in(block_key, 1)) < self.exploration)
        random_action = jax.random.uniform(block_key, (env.action_size,), minval=-1.0, maxval=1.0)
        return jnp.where(explores, random_action, super().act(key, env, actor, obs, moment, method_state))

    def learn(
        self, key: jax.Array, env: Env, agent: Any, batch: Batch, phase: jax.Array, method_state: Any
    ) -> tuple[Any, Any, dict[str, jax.Array]]:
        """Return the agent after an update, of its critics alone in the warm-up, or as it is without `learning`.

        Raises:
            ValueError: the learner is not SAC, of which the parts of the critics are known here.
        """
        if not self.learning:
            return agent, method_state, dict.fromkeys(self.learner.diagnostics, jnp.zeros(()))
        if not isinstance(self.learner, SAC):
            raise InputError(
                f"cfbrl can keep an actor as cloned with the learner 'sac' only, not {self.learner.name!r}"
            )
        updated, _, diagnostics = super().learn(key, env, agent, batch, phase, method_state)
        assert batch.step is not None
        critics_only = agent.replace(
            critics=updated.critics,
            targets=updated.targets,
            moments={**agent.moments, "critics": updated.moments["critics"]},
        )
        return tree_where(batch.step < self.warmup, critics_only, updated), method_state, diagnostics

    def prepare(
        self, key: jax.Array, env: Env, goals: Goals, batch: TransitionBatch, phase: jax.Array, method_state: Any
    ) -> TransitionBatch:
        """Return `batch` with some goals and places replaced, and `demonstrated` where the action is still to clone.

        With `fixed_phases`, no transition ends at its goal.
        """
        if not env.sparse:
            return batch
        goal = jnp.asarray(goals.table)[batch.flags.goal]
        later = _later_states(jax.random.fold_in(key, 4), goals, batch)
        steps = Steps(batch.state, batch.action, batch.next_state, later, goal)
        steps, changed, to_clone = self.transform(key, env, steps, ~batch.flags.no_successor, batch.demonstrated)
        batch = batch._replace(
            state=steps.state,
            action=steps.action,
            next_state=steps.next_state,
            goal=steps.goal,
            demonstrated=batch.demonstrated & to_clone,
        )
        batch = rescored(env, batch, steps.goal, changed)
        return batch._replace(flags=batch.flags._replace(reached=batch.flags.reached & (not self.fixed_phases)))

    def transform(
        self, key: jax.Array, env: Env, steps: Steps, allowed: jax.Array, demonstrated: jax.Array
    ) -> tuple[Steps, jax.Array, jax.Array]:
        """Return `steps [B]` of which some of the `allowed [B]` are corrected, have hindsight goals, or are moved.

        Corrected are `demonstrated [B]` ones only. Also returns the changed ones, bool [B], and those whose action a
        demonstrator could have taken, bool [B]: not the moved ones that keep their goal, nor those that have reached
        their hindsight goal already. An approach to the object serves every goal.
        """
        goal_key, place_key, offset_key = jax.random.split(key, 3)
        steps, corrected, approach = self.corrected_steps(
            jax.random.fold_in(key, 3), env, steps, allowed & demonstrated
        )
        moved = allowed & jax.random.bernoulli(place_key, self.translated, allowed.shape)
        offset = _offsets(offset_key, env, steps, moved)
        moved = (offset != 0).any(axis=-1)
        state, following, later = (part + offset for part in (steps.state, steps.next_state, steps.later))
        goal, hindsight, achieved = steps.goal, jnp.zeros_like(allowed), knowledge_of(env).goal_from(later)
        if achieved is not None:
            hindsight = allowed & jax.random.bernoulli(goal_key, self.hindsight, allowed.shape)
            goal = jnp.where(hindsight[:, None], achieved, goal)
        ahead = ~env.success(jnp.concatenate([state, goal], axis=-1))
        to_clone = jnp.where(hindsight | approach, ahead, ~moved)
        return Steps(state, steps.action, following, later, goal), hindsight | moved | corrected, to_clone

    def corrected_steps(
        self, key: jax.Array, env: Env, steps: Steps, allowed: jax.Array
    ) -> tuple[Steps, jax.Array, jax.Array]:
        """Return `steps [B]` with corrections of some of the `allowed [B]`; which, and which are approaches, bool [B]."""
        draw_key, goal_key, choice_key, env_key = jax.random.split(key, 4)
        keys = jax.random.split(env_key, len(allowed))
        correction = jax.vmap(knowledge_of(env).correction)(keys, steps.state, steps.action, steps.next_state)
        if correction is None:
            return steps, jnp.zeros_like(allowed), jnp.zeros_like(allowed)
        drawn = [
            jax.random.choice(jax.random.fold_in(goal_key, len(goals)), goals, allowed.shape)
            for goals in (env.goal_states, env.initial_states)
        ]
        goal = jnp.where(jax.random.bernoulli(choice_key, shape=(len(allowed), 1)), *drawn)
        approach = correction.approach & allowed
        goal = jnp.where(approach[:, None], goal, steps.goal)
        other = Steps(correction.state, correction.action, correction.next_state, steps.later, goal)
        chosen = allowed & jax.random.bernoulli(draw_key, self.corrected, allowed.shape)
        return tree_where(chosen[:, None], other, steps), chosen, approach

    def pretrain(self, key: jax.Array, env: Env, agent: Any, demos: DemoSteps | None) -> Any:
        if demos is not None and self.learner.pretrain_steps and env.sparse:
            demos = self.transformed_demos(jax.random.fold_in(key, 1), env)
        return super().pretrain(key, env, agent, demos)

    def transformed_demos(self, key: jax.Array, env: Env) -> DemoSteps:
        """Return `COPIES` of each demonstrated step, transformed where their action can be cloned, else as they are."""
        original, last = _demonstrated(env)
        index = np.tile(np.arange(len(last)), COPIES)
        later_key, transform_key = jax.random.split(key)
        draw = jax.random.uniform(later_key, index.shape) * (last[index] - index + 1)
        steps = jax.tree.map(lambda part: part[index], original)
        steps = steps._replace(later=original.next_state[index + jnp.floor(draw).astype(jnp.int32)])
        every = jnp.ones(len(index), bool)
        new, _, to_clone = self.transform(transform_key, env, steps, every, every)
        new = tree_where(to_clone[:, None], new, steps)
        obs = jnp.concatenate([new.state, new.goal], axis=-1)
        return DemoSteps(obs, new.action, np.zeros(len(index), int))


def _later_states(key: jax.Array, goals: Goals, batch: TransitionBatch) -> jax.Array:
    """Return the later states [B, s] of `batch`, of demonstrated rows those of the same demonstration.

    Another demonstration, which can follow in the replay, says nothing about the goals that an action serves.
    """
    assert batch.later is not None
    if not len(goals.ends):
        return batch.later
    row = later_demonstrated(goals, batch.row, jax.random.uniform(key, batch.row.shape))
    return jnp.where(batch.demonstrated[:, None], jnp.asarray(goals.candidates)[row], batch.later)


def _offsets(key: jax.Array, env: Env, steps: Steps, moved: jax.Array) -> jax.Array:
    """Return a translation [B, s] of each of the `moved` steps, and 0 for the others and without translations."""
    offset = jax.vmap(knowledge_of(env).translation)(jax.random.split(key, len(moved)), steps.state, steps.next_state)
    return jnp.zeros_like(steps.state) if offset is None else jnp.where(moved[:, None], offset, 0.0)


def _demonstrated(env: Env) -> tuple[Steps, np.ndarray]:
    """Return all demonstrated steps, and for each the last step of its demonstration, [T]."""
    parts = [env.demonstrations.load(direction) for direction in env.demonstrations.directions]
    states, following, goals, actions, ends = (
        np.concatenate([getattr(part, name) for part in parts])
        for name in ("states", "next_states", "goals", "actions", "ends")
    )
    last = np.flatnonzero(ends)
    last = last[np.searchsorted(last, np.arange(len(ends)))]
    return Steps(*map(jnp.asarray, (states, actions, following, following, goals))), last
