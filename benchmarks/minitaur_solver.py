"""Measure cost and fidelity of other settings of the Minitaur's solver: `python -m benchmarks.minitaur_solver reference.json`.

Each variant repeats the recorded stances and trots on engine `c` (`benchmarks.minitaur_trots`) in a separate process. There its
control step is timed in turn with the shipped one, on one core, without the motors. `relative_time` is the ratio of the shortest
times, which other work on the machine hardly changes. Writes solver_minitaur.csv and .json below benchmarks/results/physics.
"""

import argparse
import multiprocessing
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import mujoco
import mujoco.batch

from benchmarks import minitaur_trots
from benchmarks.host_step import rows_of
from benchmarks.output import save
from earl_jax import assets, physics
from earl_jax.envs import make
from earl_jax.envs.minitaur import motors
from earl_jax.physics.engines import c
from earl_jax.report.tables import write

NAME, LANES, REPEATS = "minitaur_pen", 4, 500
RESULTS = Path(__file__).parent / "results" / "physics"


def options(**values: Any) -> Callable[[Any], None]:
    """Return a change of a model's options."""

    def change(model: Any) -> None:
        for field, value in values.items():
            setattr(model.opt, field, value)

    return change


def longer_lead(model: Any) -> None:
    """Let commands lead by 150 rad/s over one substep, which is 0.3 rad with five."""
    motors.MAX_LEAD = 150.0 * model.opt.timestep


def islands(model: Any) -> None:
    model.opt.disableflags &= ~int(mujoco.mjtDisableBit.mjDSBL_ISLAND)


VARIANTS: dict[str, tuple[int, Callable[[Any], None]]] = {
    "as shipped": (5, options()),
    "with islands": (5, islands),
    "4 substeps": (4, options()),
    "4 substeps, commands lead by 0.375 rad": (4, longer_lead),
    "3 substeps": (3, options()),
    "2 substeps": (2, options()),
    "10 substeps": (10, options()),
    "1 iteration": (5, options(iterations=1)),
    "2 iterations": (5, options(iterations=2)),
    "50 iterations": (5, options(iterations=50, ls_iterations=50)),
    "3 line searches": (5, options(ls_iterations=3)),
    "elliptic cone": (5, options(cone=mujoco.mjtCone.mjCONE_ELLIPTIC)),
    "sparse Jacobian": (5, options(jacobian=mujoco.mjtJacobian.mjJAC_SPARSE)),
    "implicitfast": (5, options(integrator=mujoco.mjtIntegrator.mjINT_IMPLICITFAST)),
}


def relative_time(substeps: int, model: Any) -> float:
    """Return the time of a control step of `model` relative to the shipped one."""
    env = make(NAME, engine="c", randomize=False)
    simulations = c.host_of(env.simulator, env.reset(jax.random.key(0)).data.memory.size).simulations(LANES, 1)
    rows = rows_of(env, LANES)
    for part, columns in simulations.inputs:
        part[:] = rows[:, columns]
    state, times = simulations.batch.state.copy(), []
    shipped = mujoco.MjModel.from_xml_path(str(assets.mjcf(NAME)))
    batches = [mujoco.batch.Batch(part, LANES, 1) for part in (shipped, model)]
    for _ in range(REPEATS):
        for batch, count in zip(batches, (5, substeps), strict=True):
            batch.state[:] = state
            began = time.perf_counter()
            batch.step(nstep=count)
            times.append(time.perf_counter() - began)
    return round(min(times[1::2]) / min(times[::2]), 3)


def try_variant(file: Path, variant: str) -> dict[str, Any]:
    """Return fidelity and time of `variant`. It changes the model of this process, so call it in a new one."""
    substeps, change = VARIANTS[variant]
    model = physics.load_model(NAME, make(NAME, engine="c", substeps=substeps).simulator.timestep)
    change(model)
    report = minitaur_trots.report(file, "c", substeps)
    return {
        "variant": variant, "relative_time": relative_time(substeps, model),
        "worst_height_error_mm": report["worst_height_error_mm"],
        **{f"trot_{name}_ratio": trot["ratio"] for name, trot in report["trots"].items()},
        **{f"trot_{name}_motor_rmse_rad": trot["motor_rmse_rad"] for name, trot in report["trots"].items()},
        "loop_error_mm": report["loop_error_mm"],
    }  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("file", type=Path)
    arguments = parser.parse_args()
    rows = []
    with multiprocessing.get_context("spawn").Pool(1, maxtasksperchild=1) as pool:
        for variant in VARIANTS:
            rows.append(pool.apply(try_variant, (arguments.file, variant)))
            print(rows[-1], flush=True)
    RESULTS.mkdir(parents=True, exist_ok=True)
    write(rows, RESULTS / "solver_minitaur.csv")
    command = f"python -m benchmarks.minitaur_solver {arguments.file.name}"
    save(RESULTS / "solver_minitaur.json", command, {"rows": rows})


if __name__ == "__main__":
    main()
