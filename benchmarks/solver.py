"""Measure cost and fidelity of other solver settings: `python -m benchmarks.solver sawyer_peg FILE.npz --out solver_peg`.

Each variant of the scene replays the recordings on engine `c` and is timed on one core, in a separate process. Rates are relative
to the first row. Writes NAME.csv and NAME.json below benchmarks/results/physics.
"""

import argparse
import multiprocessing
from collections.abc import Callable
from pathlib import Path
from typing import Any

import mujoco

from benchmarks.output import save
from benchmarks.physics import one_core
from benchmarks.replay_demos import replay
from earl_jax import physics
from earl_jax.envs.sawyer.base import Sawyer
from earl_jax.report.tables import write

RESULTS = Path(__file__).parent / "results" / "physics"
COLUMNS = (
    "successes_by_end",
    "successes_within_hold",
    "mean_object_error_mm",
    "reward_agreement",
    "first_success_offsets",
)


def _iterations(count: int) -> Callable[[Any], None]:
    def change(model: Any) -> None:
        model.opt.iterations = model.opt.ls_iterations = count

    return change


def _pyramidal(model: Any) -> None:
    model.opt.cone = mujoco.mjtCone.mjCONE_PYRAMIDAL


def _three_rows(model: Any) -> None:
    model.pair_dim[:] = 3


def _implicit(model: Any) -> None:
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST


VARIANTS: dict[str, tuple[int, Callable[[Any], None]]] = {
    "as shipped": (5, lambda model: None),
    "4 substeps": (4, lambda model: None),
    "3 substeps": (3, lambda model: None),
    "2 substeps": (2, lambda model: None),
    "10 substeps": (10, lambda model: None),
    "2 iterations": (5, _iterations(2)),
    "50 iterations": (5, _iterations(50)),
    "pyramidal cone": (5, _pyramidal),
    "no torsional friction": (5, _three_rows),
    "implicitfast": (5, _implicit),
}


def try_variant(name: str, file: Path, variant: str) -> dict[str, Any]:
    """Return how well `variant` replays `file` and its speed. It changes the model of this process, so call it in a new one."""
    substeps, change = VARIANTS[variant]
    model = physics.load_model(name, Sawyer.control_step / substeps)
    change(model)
    report = replay(name, file, "c", substeps)
    rate = one_core(name, variant, model, substeps)["lane_steps_per_s"]
    return {"env": name, "variant": variant, **{field: report[field] for field in COLUMNS}, "lane_steps_per_s": rate}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("env", choices=["sawyer_door", "sawyer_peg"])
    parser.add_argument("file", type=Path)
    parser.add_argument("--out", default="solver", help="name of the result files")
    arguments = parser.parse_args()
    rows = []
    with multiprocessing.get_context("spawn").Pool(1, maxtasksperchild=1) as pool:
        for variant in VARIANTS:
            rows.append(pool.apply(try_variant, (arguments.env, arguments.file, variant)))
            print(rows[-1], flush=True)
    for row in rows:
        row["relative_speed"] = round(row["lane_steps_per_s"] / rows[0]["lane_steps_per_s"], 3)
    RESULTS.mkdir(parents=True, exist_ok=True)
    write(rows, RESULTS / f"{arguments.out}.csv")
    command = f"python -m benchmarks.solver {arguments.env} {arguments.file.name} --out {arguments.out}"
    save(RESULTS / f"{arguments.out}.json", command, {"rows": rows})


if __name__ == "__main__":
    main()
