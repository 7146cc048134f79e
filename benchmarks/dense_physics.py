"""Measure cost and fidelity of physics settings of the kitchen and the lightbulb.

    python -m benchmarks.dense_physics host --lanes 1 5 10 25
    python -m benchmarks.dense_physics variants franka_kitchen --original kitchen_earl_compiled.json --check "as shipped"

`host` prints the milliseconds of a control step on engine `c`'s host, before and after, in one alternating run. `variants` times
every variant on one core in one alternating run, and with `--check` measures the fidelity of the named ones, each in its own
process: the kitchen's free arm against the original and its scripts, the lightbulb's scripted grasp and returns, and the
penetrations, limits and faults of random actions. Both write below benchmarks/results/physics.
"""

import argparse
import copy
import multiprocessing
import statistics
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple
from unittest import mock

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from benchmarks import dhand, kitchen, safety
from benchmarks.output import save
from earl_jax import assets, physics
from earl_jax.envs import make
from earl_jax.physics import PhysicsState, Simulator
from earl_jax.physics.engines.c import Host
from earl_jax.report.tables import write

RESULTS = Path(__file__).parent / "results" / "physics"
TASKS = ("franka_kitchen", "dhand_lightbulb")
BEFORE, SHIPPED = "before", "as shipped"
RECORDED = 40
"""Control steps of each lane whose starts are timed."""


class Variant(NamedTuple):
    """Substeps of a control step (None: the task's own), whether longer steps are adapted to, and a change of the model."""

    substeps: int | None = None
    adapted: bool = False
    change: Callable[[Any], None] = lambda model: None


def _set(**options: Any) -> Callable[[Any], None]:
    """Return a change of the model that sets `options` of its solver."""

    def change(model: Any) -> None:
        for field, value in options.items():
            setattr(model.opt, field, value)

    return change


DISABLE, ISLANDS = mujoco.mjtDisableBit, {"disableflags": 0}
UNSAFE = {"disableflags": int(DISABLE.mjDSBL_ISLAND | DISABLE.mjDSBL_REFSAFE)}
VARIANTS = {
    BEFORE: Variant(20, change=_set(**ISLANDS)),
    "20 substeps, no islands": Variant(20),
    "implicitfast": Variant(20, change=_set(integrator=mujoco.mjtIntegrator.mjINT_IMPLICITFAST)),
    "pyramidal cone": Variant(20, change=_set(cone=mujoco.mjtCone.mjCONE_PYRAMIDAL)),
    "3 iterations": Variant(20, change=_set(iterations=3)),
    "tolerance 1e-4": Variant(20, change=_set(tolerance=1e-4)),
    "sparse Jacobian": Variant(20, change=_set(jacobian=mujoco.mjtJacobian.mjJAC_SPARSE)),
    "conjugate gradient": Variant(20, change=_set(solver=mujoco.mjtSolver.mjSOL_CG)),
    "no visual geoms, static bodies fused": Variant(20),
    "12 substeps": Variant(12),
    "10 substeps": Variant(10),
    "10 substeps, no lower limit of time constants": Variant(10, change=_set(**UNSAFE)),
    "8 substeps": Variant(8),
    "20 substeps, adapted": Variant(20, adapted=True),
    "14 substeps, adapted": Variant(14, adapted=True),
    "12 substeps, adapted": Variant(12, adapted=True),
    "10 substeps, adapted": Variant(10, adapted=True),
    "8 substeps, adapted": Variant(8, adapted=True),
    SHIPPED: Variant(adapted=True),
}
"""Without adaptation, a model has the constants of its file at every time step."""


def load(task: str, name: str) -> tuple[Any, Any]:
    """Return the task on engine `c` and the model of the variant `name`."""
    variant = VARIANTS[name]
    env = make(task, engine="c", **({"substeps": variant.substeps} if variant.substeps else {}))
    model = physics.load_model(task, env.control_step / env.substeps) if variant.adapted else physics.load_model(task)
    model = _bare(task, model) if name.startswith("no visual") else copy.copy(model)
    model.opt.timestep = env.control_step / env.substeps
    variant.change(model)
    return env, model


def _bare(task: str, full: Any) -> Any:
    spec = mujoco.MjSpec.from_file(str(assets.mjcf(task)))
    spec.compiler.discardvisual = spec.compiler.fusestatic = True
    model = spec.compile()
    for body in map(model.body, range(model.nbody)):
        model.body_invweight0[body.id] = full.body(body.name).invweight0
    return model


def record(task: str, lanes: int) -> tuple[Any, np.ndarray]:
    """Return the physics states and commands [RECORDED, lanes, ...] at the starts of control steps."""
    env = make(task, engine="c")
    actions = jnp.asarray(safety.make_actions(10 * RECORDED, lanes, env.action_size))

    def step(state: Any, action: jax.Array) -> tuple[Any, Any]:
        started = jax.vmap(env.control)(state, action)
        return jax.vmap(env.step)(state, action), started

    start = jax.vmap(env.reset)(jax.random.split(jax.random.key(0), lanes))
    data, command = jax.jit(lambda state: jax.lax.scan(step, state, actions)[1])(start)
    return jax.tree.map(lambda leaf: np.asarray(leaf)[::10], (data, command))


def core_milliseconds(task: str, repeats: int, lanes: int = 6) -> dict[str, float]:
    """Return the milliseconds of a control step on one core for each variant, the medians of alternating repeats."""
    data, command = record(task, lanes)
    loaded = {name: load(task, name) for name in VARIANTS}
    seconds: dict[str, list[float]] = {name: [] for name in VARIANTS}
    for _ in range(repeats):
        for name, (env, model) in loaded.items():
            seconds[name].append(_simulate(model, env.substeps, data, command))
    return {name: 1e3 * statistics.median(times) / (RECORDED * lanes) for name, times in seconds.items()}


def _simulate(model: Any, substeps: int, data: PhysicsState, command: np.ndarray) -> float:
    """Return the seconds that MuJoCo takes for all recorded control steps."""
    simulated, seconds = mujoco.MjData(model), 0.0
    for index in np.ndindex(command.shape[:2]):
        simulated.qpos[:], simulated.qvel[:] = data.qpos[index], data.qvel[index]
        simulated.mocap_pos[:], simulated.mocap_quat[:] = data.mocap_pos[index], data.mocap_quat[index]
        simulated.qacc_warmstart[:], simulated.ctrl[:] = data.qacc_warmstart[index], command[index]
        began = time.perf_counter()
        mujoco.mj_step(model, simulated, substeps)
        seconds += time.perf_counter() - began
    return seconds


def check(task: str, name: str, steps: int, original: Path | None) -> dict[str, Any]:
    """Return the fidelity of a variant. It replaces the model of this process, so call it in a new one."""
    env, model = load(task, name)
    with mock.patch.object(Simulator, "mujoco_model", return_value=model):
        row = check_kitchen(env.substeps, original) if task == TASKS[0] else check_grasp(env.substeps)
        report = safety.run(task, steps, 64, "c", env.substeps)
    past = {joint: amount for joint, amount in report["past_limit_by_joint"].items() if joint not in _SOFT}
    return {
        **row, "steps_of_64_lanes": steps, "not_finite": report["not_finite"], "faults": report["faults"],
        "deepest_mm": report["worst_penetration_mm"], "contacts_over_15_mm": report["contacts_over_limit"],
        "furthest_past_limit": max(past.values(), default=0.0),
    }  # fmt: skip


_SOFT = (*(f"j{number}" for number in range(8)), "TF_ADB")
"""Joints whose limits are soft in the originals too."""


def check_kitchen(substeps: int, original: Path | None) -> dict[str, Any]:
    """Return the error of the free arm's tip on the documented paths, and the largest remaining distance of a script."""
    env, row = make("franka_kitchen", engine="c", substeps=substeps, noise=False), {}
    if original is not None:
        paths, arm = kitchen.paths(), kitchen.original_arm(original)
        tips = kitchen.follow_ours(env, np.array(list(paths.values())))
        errors = [
            1e3 * np.linalg.norm(ours - kitchen.follow(arm, path), axis=1)
            for ours, path in zip(tips, paths.values(), strict=True)
        ]
        row["tip_rmse_mm"] = round(max(float(np.sqrt((error**2).mean())) for error in errors), 2)
        row["tip_max_mm"] = round(max(float(error.max()) for error in errors), 2)
    remaining = []
    for script in kitchen.SCRIPTS.values():
        moved, _ = jax.jit(lambda script=script: kitchen.play(env, script))()
        remaining.append(abs(float(moved[-1]) - script.goal))
    return row | {"scripts_moved": sum(left < 0.15 for left in remaining), "script_error": round(max(remaining), 4)}


def check_grasp(substeps: int) -> dict[str, Any]:
    """Return lifts, holds and returns of the scripted grasp from 25 starts, and the return of no action."""
    report = dhand.measure("c", substeps, 20, 400, 0)
    return {
        "lifts": report["lifts"] + report["random_lifts"], "holds": report["holds"] + report["random_holds"],
        "held_at_the_end": sum(height > 0.9 for height in report["last_m"]),
        "return_scripted": report["return_scripted"], "return_zero": report["return_zero"],
    }  # fmt: skip


def host_milliseconds(task: str, lane_counts: list[int], repeats: int) -> list[dict[str, Any]]:
    """Return the milliseconds of the host's part of a control step by number of lanes, before and as shipped."""
    data, command = record(task, max(lane_counts))
    hosts = {name: _host(task, name) for name in (BEFORE, SHIPPED)}
    rows = []
    for lanes in lane_counts:
        inputs = [_rows(data, command, step, lanes) for step in range(RECORDED)]
        seconds: dict[str, list[float]] = {name: [] for name in hosts}
        for rows_in in inputs * repeats:
            for name, host in hosts.items():
                began = time.perf_counter()
                host(rows_in)
                seconds[name].append(time.perf_counter() - began)
        before, after = (1e3 * statistics.median(seconds[name]) for name in hosts)
        rows.append(
            {
                "env": task, "lanes": lanes, "before_ms": round(before, 4), "shipped_ms": round(after, 4),
                "ratio": round(after / before, 3),
            }
        )  # fmt: skip
        print(rows[-1], flush=True)
    return rows


def _host(task: str, name: str) -> Host:
    env, model = load(task, name)
    with mock.patch.object(Simulator, "mujoco_model", return_value=model):
        return Host(env.simulator, 0)


def _rows(data: PhysicsState, command: np.ndarray, step: int, lanes: int) -> np.ndarray:
    fields = ("time", "qpos", "qvel", "act", "qacc_warmstart", "memory", "mocap_pos", "mocap_quat", "constants")
    parts = [np.asarray(getattr(data, field))[step, :lanes].reshape(lanes, -1) for field in fields]
    return np.concatenate([*parts, command[step, :lanes]], axis=1, dtype=np.float32)


def variants(arguments: argparse.Namespace) -> list[dict[str, Any]]:
    """Return one row per variant, those to check last measured first in the list's order."""
    milliseconds, rows = core_milliseconds(arguments.env, arguments.repeats), []
    with multiprocessing.get_context("spawn").Pool(1, maxtasksperchild=1) as pool:
        for name, own in milliseconds.items():
            row = {"env": arguments.env, "variant": name, "time": round(own / milliseconds[BEFORE], 3)}
            if name in arguments.check:
                row |= pool.apply(check, (arguments.env, name, arguments.steps, arguments.original))
            rows.append(row)
            print(row, flush=True)
    fields = list(dict.fromkeys(field for row in rows for field in row))
    return [{field: row.get(field, "") for field in fields} for row in rows]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=["host", "variants"])
    parser.add_argument("env", choices=TASKS, nargs="?", help="for variants")
    parser.add_argument("--lanes", type=int, nargs="+", default=[1, 5, 10, 25])
    parser.add_argument("--repeats", type=int, default=10)
    parser.add_argument("--check", nargs="*", default=[], choices=list(VARIANTS), metavar="VARIANT")
    parser.add_argument("--steps", type=int, default=500, help="of 64 lanes of random actions")
    parser.add_argument("--original", type=Path, help="the original kitchen's compiled model")
    parser.add_argument("--out", default=None, help="name of the result files")
    arguments = parser.parse_args()
    if (arguments.what == "variants") != (arguments.env is not None):
        parser.error("variants takes one task, host takes none")
    if arguments.what == "host":
        rows = [row for task in TASKS for row in host_milliseconds(task, arguments.lanes, arguments.repeats)]
        command = f"host --lanes {' '.join(map(str, arguments.lanes))}"
    else:
        rows = variants(arguments)
        checked = "".join(f' "{name}"' for name in arguments.check)
        command = f"variants {arguments.env} --steps {arguments.steps} --check{checked}"
    out = RESULTS / (arguments.out or f"dense_{arguments.env or 'host'}")
    write(rows, out.with_suffix(".csv"))
    save(out.with_suffix(".json"), f"python -m benchmarks.dense_physics {command}", {"rows": rows})


if __name__ == "__main__":
    main()
