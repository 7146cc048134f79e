"""SAC of rejax: all seeds vmapped in one program, one env and one gradient step per iteration."""

import time

import jax
import jax.numpy as jnp
from flax import struct
from gymnax.environments import environment, spaces
from rejax import SAC

from benchmarks.speed.peers import common
from earl_jax.envs import State, make


@struct.dataclass
class TimedState:
    """An env state and the steps since its reset."""

    env_state: State
    time: jax.Array


class Tabletop(environment.Environment):
    """earl_jax's tabletop task with the interface of gymnax: it ends on success or after `HORIZON` steps and resets itself."""

    task = make(common.TABLETOP)

    def reset_env(self, key, params):
        env_state = self.task.reset(key)
        return env_state.obs, TimedState(env_state, jnp.zeros((), jnp.int32))

    def step_env(self, key, state, action, params):
        env_state = self.task.step(state.env_state, action)
        after = TimedState(env_state, state.time + 1)
        done = (env_state.metrics["success"] > 0) | (after.time >= common.HORIZON)
        return env_state.obs, after, env_state.reward, done, {}

    def action_space(self, params):
        return spaces.Box(-1.0, 1.0, (self.task.action_size,))

    def observation_space(self, params):
        return spaces.Box(-2.8, 2.8, (self.task.observation_size,))


def main() -> None:
    chosen = common.options(__doc__)
    learner = SAC.create(
        env=Tabletop(), hidden_layer_sizes=common.HIDDEN, num_critics=2, num_envs=1, num_epochs=1, batch_size=common.BATCH,
        buffer_size=common.CAPACITY, fill_buffer=0, learning_rate=common.LEARNING_RATE, polyak=0.995,
    )  # fmt: skip
    states = jax.jit(jax.vmap(learner.init_state))(jax.random.split(jax.random.PRNGKey(0), chosen.lanes))

    def advance(state):
        return jax.lax.fori_loop(0, chosen.steps, lambda _, part: learner.train_iteration(part), state)

    start, began = common.since_start(), time.perf_counter()
    program = jax.jit(jax.vmap(advance), donate_argnums=0).lower(states).compile()
    compiled = time.perf_counter() - began

    def repeat():
        nonlocal states
        states = jax.block_until_ready(program(states))

    repeat()
    seconds = common.median_s(repeat, chosen.repeats)
    common.emit(
        ("rejax", "gymnax", "distrax", "jax", "jaxlib", "flax", "optax"), peer="rejax", task=common.TABLETOP,
        device=jax.devices()[0].device_kind, lanes=chosen.lanes,
        lane_steps_per_s=chosen.steps * chosen.lanes / seconds, start_s=start, compile_s=compiled,
        note=f"its train_iteration in the loop of its train(), without the evaluations; {common.CAPACITY:,} replay rows a seed, "
        "sampled without replacement, as rejax does; updates from the first step",
    )  # fmt: skip


if __name__ == "__main__":
    main()
