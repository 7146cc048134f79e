"""R3L: between attempts at the task, a perturbation controller that is rewarded for novelty changes the state."""

from typing import Any, ClassVar

import jax
import jax.numpy as jnp
from flax import struct

from earl_jax.algos.goals import GoalIndices, Goals
from earl_jax.algos.learner.base import Batch
from earl_jax.algos.learner.networks import ADAM, MLP, apply, descend
from earl_jax.algos.learner.replay import TransitionBatch
from earl_jax.algos.method import RETURN, Method, Phase
from earl_jax.envs import Env
from earl_jax.envs.state import tree_where
from earl_jax.options.values import within

EMBEDDING = 512
_NETWORK = MLP((256, 256, EMBEDDING))


class RND(struct.PyTreeNode):
    """Random network distillation: a fixed target, its predictor with Adam's moments, and the running scale `sigma`."""

    target: Any
    predictor: Any
    moments: Any
    sigma: jax.Array

    def error(self, predictor: Any, states: jax.Array, precision: str = "tf32") -> jax.Array:
        """Return the squared prediction error [B] at `states [B, s]`, averaged over the embedding."""
        target, prediction = [apply(params, states, precision) for params in (self.target, predictor)]
        return jnp.square(target - prediction).mean(axis=-1)


class R3L(Method):
    """Alternate the task and a search for novel states.

    Alternate the task controller with a controller that seeks novel states (RND) for H_E steps and never ends early.

    Source: Zhu et al. 2020, as run by Sharma et al. 2022 with the true reward and no classifier. Novelty is the
    prediction error on the state before the step, without the goal. As in the authors' released code, it is divided by
    an exponential average of its own standard deviation, which tends to the root of the error's standard deviation. The
    predictor uses the paper's shared learning rate. The perturbation controller receives no demonstrations.
    """

    rnd_decay: float = struct.field(default=0.99, metadata=within("[0, 1)"))
    """Decay of the running scale, "RND gamma" in the paper's table."""
    rnd_clip: float = struct.field(default=1000.0, metadata=within("(0, 1000000000]"))
    """Upper bound of the intrinsic reward (released code)."""

    name: ClassVar[str] = "r3l"

    @property
    def phases(self) -> tuple[Phase, ...]:
        return Phase(), Phase((), controller=1, ends_on_success=False, has_goal=False)

    def next_goal(
        self, key: jax.Array, goals: Goals, phase: jax.Array, current: GoalIndices, method_state: Any
    ) -> GoalIndices:
        task = goals.draw_task(key)
        return tree_where(phase == RETURN, current, GoalIndices(goal=task, task=task))

    def init(self, key: jax.Array, env: Env, goals: Goals) -> RND:
        example = jnp.zeros((env.state_size,))
        target, predictor = [_NETWORK.init(network_key, example) for network_key in jax.random.split(key)]
        return RND(target, predictor, ADAM.init(predictor), jnp.ones(()))

    def prepare(
        self, key: jax.Array, env: Env, goals: Goals, batch: TransitionBatch, phase: jax.Array, method_state: RND
    ) -> TransitionBatch:
        """Return `batch` with the novelty of its states as the reward of the perturbation controller."""
        error = method_state.error(method_state.predictor, batch.state, self.learner.precision)
        novelty = jnp.clip(error / method_state.sigma, 0.0, self.rnd_clip)
        return batch._replace(reward=jnp.where(phase == RETURN, novelty, batch.reward))

    def learn(
        self, key: jax.Array, env: Env, agent: Any, batch: Batch, phase: jax.Array, method_state: RND
    ) -> tuple[Any, RND, dict[str, jax.Array]]:
        """Return the controller after the learner's update; perturbation phases also update RND on the same states."""
        agent, _, diagnostics = super().learn(key, env, agent, batch, phase, method_state)
        updated = self.distil(method_state, batch.obs[:, : env.state_size])
        return agent, tree_where(phase == RETURN, updated, method_state), diagnostics

    def distil(self, rnd: RND, states: jax.Array) -> RND:
        """Return `rnd` after an Adam step of its predictor on `states [B, s]` and an update of its running scale."""

        def loss(predictor):
            errors = rnd.error(predictor, states, self.learner.precision)
            return errors.mean(), errors

        grads, errors = jax.grad(loss, has_aux=True)(rnd.predictor)
        predictor, moments = descend(rnd.predictor, grads, rnd.moments, self.learner.learning_rate)
        spread = jnp.maximum((errors / rnd.sigma).std(), 1e-3)
        sigma = self.rnd_decay * rnd.sigma + (1 - self.rnd_decay) * spread
        return rnd.replace(predictor=predictor, moments=moments, sigma=sigma)
