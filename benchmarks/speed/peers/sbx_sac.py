"""SAC of SBX (Stable Baselines in JAX): one seed per process, a Python loop over a NumPy env and one jitted update."""

import time

import jax
from sbx import SAC
from stable_baselines3.common.callbacks import BaseCallback

from benchmarks.speed.peers import common
from benchmarks.speed.peers.numpy_tabletop import NumpyTabletop

LEARNING_STARTS = 256
WARM_UP = 512
"""Steps before the clock starts: the random steps, the steps that compile, and as many again."""


class Clock(BaseCallback):
    """Records the time at step `WARM_UP`, and every `steps` after it."""

    def __init__(self, chosen):
        super().__init__()
        self.chosen, self.times = chosen, []

    def _on_step(self) -> bool:
        steps = self.num_timesteps - WARM_UP
        if steps >= 0 and steps % self.chosen.steps == 0:
            self.times.append(time.perf_counter())
        return True


def main() -> None:
    chosen = common.options(__doc__)
    model = SAC(
        "MlpPolicy", NumpyTabletop(common.HORIZON), learning_rate=common.LEARNING_RATE, buffer_size=1_000_000,
        batch_size=common.BATCH, learning_starts=LEARNING_STARTS, train_freq=1, gradient_steps=1, seed=0,
        policy_kwargs={"net_arch": list(common.HIDDEN), "n_critics": 2},
    )  # fmt: skip
    start, clock = common.since_start(), Clock(chosen)
    model.learn(WARM_UP + chosen.steps * chosen.repeats, callback=clock)
    durations = sorted(after - before for before, after in zip(clock.times, clock.times[1:], strict=False))
    common.emit(
        ("sbx-rl", "stable-baselines3", "jax", "jaxlib", "torch", "gymnasium"), peer="sbx", task=common.TABLETOP,
        device=jax.devices()[0].device_kind, lanes=1,
        lane_steps_per_s=chosen.steps / durations[len(durations) // 2], start_s=start,
        compile_s=clock.times[0] - common.BEGAN - start,
        note="replay of 1,000,000; compile_s includes the 512 steps before the clock starts",
    )  # fmt: skip


if __name__ == "__main__":
    main()
