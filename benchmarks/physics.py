"""Measure control steps per second of every engine, without compile time, beside an original-style C loop.

    python -m benchmarks.physics --lanes 1 100 1000 --engines c mjx warp --out benchmarks/results/physics/h200

Actions are random. A control step is that of the task, with observation and reward. The original-style loop, for the Sawyer
tasks, steps MuJoCo C on one core from Python, in a scene with the original's geoms (51 colliding geoms, no listed pairs).
"""

import argparse
import os
import statistics
import time
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from benchmarks.output import save
from earl_jax import assets, physics
from earl_jax.envs import list_envs, make
from earl_jax.physics.engine_choice import ENGINES
from earl_jax.report.tables import write

ENVS = [name for name in list_envs() if make(name).engine != "kinematic"]
REBUILT = ("sawyer_door", "sawyer_peg")
"""Tasks with an original-style scene."""
MIN_SECONDS = 1.0
"""The shortest time of a timed repeat."""


def make_task(name: str, engine: str, substeps: int | None) -> Any:
    """Return the task `name` on `engine`, with its own `substeps` if they are None."""
    return make(name, engine=engine, **({"substeps": substeps} if substeps else {}))


def measure(name: str, engine: str, lanes: int, substeps: int | None, repeats: int) -> dict[str, Any]:
    """Return compile seconds and the median rate of one env, engine and number of lanes."""
    env = make_task(name, engine, substeps)
    state = jax.jit(jax.vmap(env.reset))(jax.random.split(jax.random.key(0), lanes))

    def run(state, key, steps):
        def step(state, key):
            action = jax.random.uniform(key, (lanes, env.action_size), minval=-1.0, maxval=1.0)
            return jax.vmap(env.step)(state, action), None

        return jax.lax.scan(step, state, jax.random.split(key, steps))[0]

    began = time.perf_counter()
    steps = 10
    program = jax.jit(run, static_argnums=2, donate_argnums=0)
    state = jax.block_until_ready(program(state, jax.random.key(1), steps))
    compiled = time.perf_counter() - began
    began = time.perf_counter()
    state = jax.block_until_ready(program(state, jax.random.key(2), steps))
    first_rate = steps / (time.perf_counter() - began)
    steps = max(10, int(first_rate * MIN_SECONDS))
    state = jax.block_until_ready(program(state, jax.random.key(3), steps))
    rates = []
    for repeat in range(repeats):
        began = time.perf_counter()
        state = jax.block_until_ready(program(state, jax.random.key(4 + repeat), steps))
        rates.append(steps / (time.perf_counter() - began))
    rate = statistics.median(rates)
    return {
        "env": name, "engine": engine, "substeps": env.substeps, "lanes": lanes, "compile_s": round(compiled, 2),
        "ms_per_step": round(1e3 / rate, 4), "lane_steps_per_s": round(rate * lanes, 1),
        "finite": bool(jnp.isfinite(state.obs).all()),
    }  # fmt: skip


def original_style(name: str) -> mujoco.MjModel:
    """Return our scene with the geoms and collisions of the original: cylinders, seven boxes, split fingers, no pairs."""
    spec = mujoco.MjSpec.from_file(str(assets.mjcf(name)))
    spec.option.iterations, spec.option.ls_iterations, spec.option.tolerance = 50, 50, 1e-10
    for pair in list(spec.pairs):
        spec.delete(pair)
    box = mujoco.mjtGeom.mjGEOM_BOX
    for side, inward in (("right", 0.003), ("left", -0.003)):
        finger = spec.geom(f"{side}_finger")
        finger.size, finger.pos = [0.045, 0.003, 0.015], [0, 0, 0]
        spec.body(f"{side}_claw").add_geom(name=f"{side}_pad", type=box, size=finger.size, pos=[0, inward, 0], mass=0)
    if name == "sawyer_door":
        hard = ["panel", *_cylinders(spec)]
        spec.delete(spec.geom("frame"))
        frame = [geom.name for geom in _named(spec.body("door").geoms)]
        spec.joint("door").damping, spec.joint("door").armature = [2.0, 0.0, 0.0], 0.001
        hard += frame
    else:
        hard = ["peg", *_seven_boxes(spec)]
        for axis in "xyz":
            spec.delete(spec.joint(f"peg_{axis}"))
        peg = spec.body("peg")
        peg.add_freejoint()
        peg.inertia = [1e5] * 3
    for geom in ["table", "palm", "right_finger", "right_pad", "left_finger", "left_pad", *hard]:
        spec.geom(geom).contype = spec.geom(geom).conaffinity = 1
    return spec.compile()


def _named(geoms: Any) -> list[Any]:
    for number, geom in enumerate(geoms):
        geom.name = geom.name or f"part_{number}"
    return list(geoms)


def _cylinders(spec: Any) -> list[str]:
    for geom in ("bar", "grip", "stem"):
        spec.geom(geom).type = mujoco.mjtGeom.mjGEOM_CYLINDER
    return ["bar", "grip", "stem"]


def _seven_boxes(spec: Any) -> list[str]:
    block = spec.body("block")
    for geom in list(block.geoms):
        spec.delete(geom)
    sizes = {
        "lid": ([0.09, 0.1, 0.005], [0, 0, 0.195]), "base": ([0.09, 0.096, 0.05], [0, 0, 0.05]),
        "west": ([0.03, 0.096, 0.03], [-0.06, 0, 0.13]), "east": ([0.03, 0.096, 0.03], [0.06, 0, 0.13]),
        "roof": ([0.09, 0.096, 0.015], [0, 0, 0.175]), "far_wall": ([0.005, 0.1, 0.1], [0.095, 0, 0.1]),
        "near_wall": ([0.005, 0.1, 0.1], [-0.095, 0, 0.1]),
    }  # fmt: skip
    for geom, (size, pos) in sizes.items():
        block.add_geom(name=geom, type=mujoco.mjtGeom.mjGEOM_BOX, size=size, pos=pos)
    return list(sizes)


def one_core(name: str, scene: str, model: mujoco.MjModel, substeps: int = 5, seconds: float = 4.0) -> dict[str, Any]:
    """Return the rate of a Python loop over MuJoCo C on one core, with `model` of task `name`."""
    env = make(name, engine="c")
    start, data = jax.device_get(env.reset(jax.random.key(0)).data), mujoco.MjData(model)
    rng, steps = np.random.default_rng(0), 0
    began = time.perf_counter()
    while time.perf_counter() - began < seconds:
        if steps % env.eval_horizon == 0:
            mujoco.mj_resetData(model, data)
            data.qpos[: len(start.qpos)] = start.qpos
            data.mocap_pos[:], data.mocap_quat[:] = start.mocap_pos, start.mocap_quat
        action = rng.uniform(-1, 1, 4)
        data.mocap_pos[0] = np.clip(data.mocap_pos[0] + 0.01 * action[:3], [-0.5, 0.4, 0.05], [0.5, 1.0, 0.5])
        data.ctrl[:] = action[3], -action[3]
        mujoco.mj_step(model, data, substeps)
        np.linalg.norm(data.sensordata[3:6] - data.sensordata[6:9])
        steps += 1
    return {
        "env": name, "engine": f"one-core C, {scene}", "substeps": substeps, "lanes": 1,
        "compile_s": 0.0, "ms_per_step": round(1e3 * seconds / steps, 4),
        "lane_steps_per_s": round(steps / seconds, 1), "finite": bool(np.isfinite(data.qpos).all()),
    }  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--envs", nargs="+", default=list(ENVS), choices=ENVS)
    parser.add_argument("--engines", nargs="+", default=["c", "mjx"], choices=ENGINES)
    parser.add_argument("--lanes", type=int, nargs="+", default=[1, 100, 1000])
    parser.add_argument("--substeps", type=int, nargs="+", default=[None], help="other than each task's own")
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results/physics/run"))
    arguments = parser.parse_args()
    arguments.out.parent.mkdir(parents=True, exist_ok=True)
    rows = []
    for name in arguments.envs:
        settings = [
            (engine, lanes, substeps)
            for engine in arguments.engines
            for lanes in arguments.lanes
            for substeps in arguments.substeps
        ]
        scenes = {}
        if name in REBUILT:
            scenes = {"original-style scene": original_style(name), "our scene": physics.load_model(name)}
        jobs = [
            lambda scene=scene, model=model, name=name: one_core(name, scene, model) for scene, model in scenes.items()
        ]
        jobs += [lambda setting=setting, name=name: measure(name, *setting, arguments.repeats) for setting in settings]
        for job in jobs:
            rows.append(job())
            print(rows[-1], flush=True)
            save_rows(rows, arguments)


def save_rows(rows: list[dict[str, Any]], arguments: argparse.Namespace) -> None:
    """Write the rows so far as csv, and as json with the command, cores and versions."""
    options = {field: getattr(arguments, field) for field in ("envs", "engines", "lanes", "substeps")}
    given = {field: values for field, values in options.items() if values != [None]}
    text = " ".join(f"--{name} {' '.join(map(str, values))}" for name, values in given.items())
    command = f"python -m benchmarks.physics {text}"
    write(rows, arguments.out.with_suffix(".csv"))
    save(arguments.out.with_suffix(".json"), command, {"cores": len(os.sched_getaffinity(0)), "rows": rows})


if __name__ == "__main__":
    main()
