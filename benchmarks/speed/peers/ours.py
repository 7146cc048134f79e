"""earl_jax itself: naive SAC with all seeds in one program, timed by `benchmarks.speed`."""

import jax

from benchmarks.speed.peers import common
from benchmarks.speed.training import measure


def main() -> None:
    chosen = common.options(__doc__, env={"required": True})
    start = common.since_start()
    row = measure(chosen.env, "naive", chosen.lanes, chosen.steps, chosen.repeats)
    common.emit(
        ("earl-jax", "jax", "jaxlib", "flax", "optax"), peer="earl_jax", task=chosen.env, device=jax.devices()[0].device_kind,
        lanes=chosen.lanes, lane_steps_per_s=row["lane_steps_per_s"], start_s=start, compile_s=row["compile_s"],
        note=f"naive SAC, engine {row['engine']}, batch {common.BATCH}, {common.CAPACITY:,} replay rows per seed",
    )  # fmt: skip


if __name__ == "__main__":
    main()
