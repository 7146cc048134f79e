"""MEDAL: a classifier rewards the backward controller for states that resemble the demonstrations."""

from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from earl_jax.algos.goals import GoalIndices, Goals
from earl_jax.algos.learner.base import Learner
from earl_jax.algos.learner.cloning import DemoSteps
from earl_jax.algos.learner.networks import ADAM, MLP, apply, descend
from earl_jax.algos.learner.replay import TransitionBatch
from earl_jax.algos.learner.sac import SAC
from earl_jax.algos.method import FORWARD, RETURN, TASK, Method, Phase, PhaseDemos
from earl_jax.envs import Env
from earl_jax.envs.state import tree_where
from earl_jax.options.values import COUNT, within

HALF_BATCH = 400
"""Rows of each class in a step of the classifier (released)."""
SMALLEST = 1e-10
"""Added to the probability in the reward (released), so that the reward is at most 23."""
_NETWORK = MLP((128, 1))


class Classifier(struct.PyTreeNode):
    """The classifier C, which returns log-odds: parameters, Adam's moments, and the metrics of its last step."""

    params: Any
    moments: Any
    loss: jax.Array
    accuracy: jax.Array

    @property
    def metrics(self) -> dict[str, jax.Array]:
        return {"classifier_loss": self.loss, "classifier_accuracy": self.accuracy}


class MEDAL(Method):
    """As FBRL, but back to the states of the demonstrations.

    Alternate a forward controller on task goals and a backward one that seeks the states of the demonstrations.

    The classifier C(s, g) tells states D+ of the forward demonstrations from states D- of backward phases. The backward
    reward is `-log(1 - sigmoid(C(s', g)) + 1e-10)` with the current C, times the reward scale, where g is the task goal
    of the attempt that follows. A forward phase ends at success or after `phase_steps`, a backward one after
    `phase_steps` only. All ends are terminal by default. Every `refresh_every` steps, C makes an Adam step on the
    binary cross-entropy of 400 rows of each class, mixed: `x <- m x + (1 - m) x_p` and labels alike, with m ~ Beta(1,
    1) for each row and a random permutation p of the 800.

    The forward controller's replay starts with the forward demonstrations, the backward controller's with these and
    with the backward demonstrations under every task goal. In cloning (`Learner.cloning`, `Learner.pretrain_steps`),
    the backward controller imitates the backward demonstrations only.

    Source: Sharma, Ahmad and Finn 2022, "A State-Distribution Matching Approach to Non-Episodic Reinforcement Learning"
    (MEDAL), and its released code, which has the constants. Deliberate differences: networks,
    temperature's loss (in log alpha instead of alpha) and optimiser are this package's `SAC`, without the release's
    trunk `Linear(50), LayerNorm, tanh` that both critics share; the first steps are uniformly random, where the release
    acts with the untrained policy, and C learns after them; rows of D+ and D- are drawn with replacement; D- leaves out
    the last state of a phase; batches are full, where the release drops rows; a hard reset in a forward phase keeps the
    goal; the end of a demonstration is terminal because it reaches its goal.
    """

    learner: Learner = SAC(random_steps=10_000)
    phase_steps: int = struct.field(pytree_node=False, default=300, metadata=within(COUNT))
    """Steps of a phase (released, on every task; the paper: H_E)."""
    refresh_every: int = struct.field(pytree_node=False, default=10, metadata=within(COUNT))
    """Steps between steps of the classifier (released)."""

    name: ClassVar[str] = "medal"
    needs_demos: ClassVar[bool] = True
    refresh_batch_size: ClassVar[int] = HALF_BATCH

    @property
    def phases(self) -> tuple[Phase, ...]:
        sampled = FORWARD, PhaseDemos("backward", every_goal=True)
        back = Phase(sampled, controller=1, length=self.phase_steps, ends_on_success=False, has_goal=False)
        return Phase(length=self.phase_steps), back

    def next_goal(
        self, key: jax.Array, goals: Goals, phase: jax.Array, current: GoalIndices, method_state: Any
    ) -> GoalIndices:
        """Return the goals of a new phase: a backward phase draws a task goal, which the next forward phase keeps."""
        task = jnp.where(phase == RETURN, goals.draw_task(key), current.task)
        return GoalIndices(goal=task, task=task)

    def prepare(
        self, key: jax.Array, env: Env, goals: Goals, batch: TransitionBatch, phase: jax.Array, method_state: Classifier
    ) -> TransitionBatch:
        """Return `batch` with a random task goal for backward demonstrations, and the classifier's reward in backward phases.

        A backward phase clones only the backward demonstrations.
        """
        backward = batch.demonstrated & (batch.flags.goal >= goals.tasks) & (phase == RETURN)
        task = jax.random.randint(key, backward.shape, 0, goals.tasks)
        flags = batch.flags._replace(goal=jnp.where(backward, task, batch.flags.goal))
        batch = batch._replace(flags=flags, demonstrated=batch.demonstrated & (backward | (phase == TASK)))
        reward = jnp.where(phase == RETURN, self.demo_likeness(goals, batch, method_state), batch.reward)
        return batch._replace(reward=reward)

    def demo_likeness(self, goals: Goals, batch: TransitionBatch, classifier: Classifier) -> jax.Array:
        """Return the classifier's reward [B] at s', or at s if a reset overwrote s'."""
        state = jnp.where(batch.flags.no_successor[:, None], batch.state, batch.next_state)
        obs = jnp.concatenate([state, jnp.asarray(goals.table)[batch.flags.goal]], axis=-1)
        logits = apply(classifier.params, obs, self.learner.precision)[:, 0]
        return -jnp.log(jax.nn.sigmoid(-logits) + SMALLEST)

    def init(self, key: jax.Array, env: Env, goals: Goals) -> Classifier:
        params = _NETWORK.init(key, jnp.zeros((env.observation_size,)))
        return Classifier(params, ADAM.init(params), jnp.zeros(()), jnp.zeros(()))

    def refresh(
        self,
        key: jax.Array,
        env: Env,
        goals: Goals,
        agent: Any,
        batch: TransitionBatch | None,
        method_state: Classifier,
    ) -> Classifier:
        """Return the classifier after a training step; before the first backward phase it stays unchanged."""
        assert batch is not None
        row_key, mix_key = jax.random.split(key)
        demonstrated = jnp.asarray(demonstrated_obs(env))
        positive = demonstrated[jax.random.randint(row_key, (HALF_BATCH,), 0, len(demonstrated))]
        negative = jnp.concatenate([batch.state, jnp.asarray(goals.table)[batch.flags.goal]], axis=-1)
        updated = self.classify(mix_key, method_state, positive, negative)
        none_yet = batch.demonstrated[0]
        return tree_where(none_yet, method_state, updated)

    def classify(
        self, key: jax.Array, method_state: Classifier, positive: jax.Array, negative: jax.Array
    ) -> Classifier:
        """Return the classifier after an Adam step on mixed rows of `positive [B, o]` and `negative [C, o]`."""
        label = jnp.concatenate([jnp.ones(len(positive)), jnp.zeros(len(negative))])
        obs, mixed = mix(key, jnp.concatenate([positive, negative]), label)

        def loss(params):
            logits = apply(params, obs, self.learner.precision)[:, 0]
            agrees = (logits > 0) == (mixed > 0.5)
            return (jax.nn.softplus(logits) - mixed * logits).mean(), agrees.mean()

        (value, accuracy), grads = jax.value_and_grad(loss, has_aux=True)(method_state.params)
        params, moments = descend(method_state.params, grads, method_state.moments, self.learner.learning_rate)
        return Classifier(params, moments, value, accuracy)

    def pretrain(self, key: jax.Array, env: Env, agent: Any, demos: DemoSteps | None) -> Any:
        return super().pretrain(key, env, agent, None if demos is None else demos_to_clone(env, demos))


def mix(key: jax.Array, rows: jax.Array, labels: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Return `rows [B, o]` and `labels [B]`, each mixed with another: mixup (Zhang et al. 2018) with Beta(1, 1)."""
    order_key, share_key = jax.random.split(key)
    other = jax.random.permutation(order_key, len(rows))
    share = jax.random.uniform(share_key, labels.shape)
    mixed = share[:, None] * rows + (1 - share)[:, None] * rows[other]
    return mixed, share * labels + (1 - share) * labels[other]


def demonstrated_obs(env: Env) -> np.ndarray:
    """Return D+: the states of the forward demonstrations with their goals, [T + D, o]."""
    demos = env.demonstrations.load("forward")
    states = np.concatenate([demos.states, demos.next_states[demos.ends]])
    return np.concatenate([states, np.concatenate([demos.goals, demos.goals[demos.ends]])], axis=-1)


def demos_to_clone(env: Env, demos: DemoSteps) -> DemoSteps:
    """Return the forward controller's demonstrations, and for the backward one its own under each task goal."""
    size, tasks = env.state_size, env.goal_states
    is_forward = (np.abs(demos.obs[:, None, size:] - tasks).max(axis=-1) < 1e-6).any(axis=1)
    forward, back = demos.controller == TASK, (demos.controller == RETURN) & ~is_forward
    count = int(back.sum())
    goals, states = np.repeat(tasks, count, axis=0), np.tile(demos.obs[back, :size], (len(tasks), 1))
    return DemoSteps(
        obs=np.concatenate([demos.obs[forward], np.concatenate([states, goals], axis=-1)]),
        action=np.concatenate([demos.action[forward], np.tile(demos.action[back], (len(tasks), 1))]),
        controller=np.repeat([TASK, RETURN], [int(forward.sum()), count * len(tasks)]),
    )
