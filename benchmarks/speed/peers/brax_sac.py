"""SAC of brax: one seed per process, the whole loop in one program. Rates are those of brax, without the first epoch."""

import functools
import statistics
from typing import Any

import jax
import jax.numpy as jnp
from brax import envs
from brax.training.agents.sac import networks, train

from benchmarks.speed.peers import common
from earl_jax.envs import make

WARM_UP = 256


class Tabletop(envs.Env):
    """earl_jax's tabletop task under brax's contract; brax's own wrapper ends episodes and resets them."""

    task = make(common.TABLETOP)
    observation_size, action_size, backend = task.observation_size, task.action_size, "none"

    def reset(self, rng: jax.Array) -> envs.State:
        env_state, zero = self.task.reset(rng), jnp.zeros(())
        return envs.State(env_state, env_state.obs, zero, zero, {}, {})

    def step(self, state: envs.State, action: jax.Array) -> envs.State:
        env_state = self.task.step(state.pipeline_state, action)
        return state.replace(
            pipeline_state=env_state, obs=env_state.obs, reward=env_state.reward, done=env_state.metrics["success"]
        )


def replicated(tree: Any, devices: list[Any]) -> Any:
    """Return `tree` with a leading axis of one device, as `jax.device_put_replicated` did before jax 0.10 removed it."""
    if len(devices) != 1:
        raise ValueError(f"one device, not {len(devices)}")
    return jax.tree.map(lambda leaf: jnp.asarray(leaf)[None], tree)


def main() -> None:
    chosen = common.options(__doc__)
    vars(jax)["device_put_replicated"] = replicated
    rates, start, ends = [], common.since_start(), []

    def progress(step, metrics):
        ends.append(common.since_start())
        rates.extend([metrics["training/sps"]] if "training/sps" in metrics else [])

    train.train(
        Tabletop(), num_timesteps=WARM_UP + (chosen.repeats + 1) * chosen.steps, episode_length=common.HORIZON, num_envs=1,
        num_eval_envs=1, num_evals=chosen.repeats + 2, min_replay_size=WARM_UP, max_replay_size=common.CAPACITY,
        batch_size=common.BATCH, grad_updates_per_step=1, learning_rate=common.LEARNING_RATE, discounting=0.99,
        max_devices_per_host=1, progress_fn=progress,
        network_factory=functools.partial(networks.make_sac_networks, hidden_layer_sizes=common.HIDDEN),
    )  # fmt: skip
    shim = "; jax.device_put_replicated, which newer jax has removed, is restored for it"
    common.emit(
        ("brax", "jax", "jaxlib", "flax", "optax"), peer="brax", task=common.TABLETOP, device=jax.devices()[0].device_kind,
        lanes=1, lane_steps_per_s=float(statistics.median(rates[1:])), start_s=start,
        compile_s=ends[1] - start, note=f"training/sps, without its evaluations; {common.CAPACITY:,} replay rows{shim}",
    )  # fmt: skip


if __name__ == "__main__":
    main()
