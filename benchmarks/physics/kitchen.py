"""Run scripts in the kitchen, and compare the motion of its arm with the original's.

    python -m benchmarks.physics.kitchen scripts
    python -m benchmarks.physics.kitchen motion path/to/kitchen_earl_compiled.json

`scripts` closes and opens objects by waypoints of the mocap body. `motion` builds the original's arm from its compiled model
(2 ms, 40 substeps, 100 Newton iterations, no collisions). Both arms follow the same mocap body along four sinusoids and four
walks between random waypoints, 300 steps each, in the box `FREE`, from the pose after a reset.
Prints one JSON line per row and writes results/kitchen/NAME.csv and .json.
"""

import argparse
import json
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from benchmarks.output import RESULTS, save
from earl_jax import physics
from earl_jax.envs import State, make
from earl_jax.envs.kitchen import reward as kitchen_reward
from earl_jax.envs.kitchen.franka_kitchen import ARM_QPOS, ARM_QVEL, MIDDLE, MOCAP_HIGH, MOCAP_LOW, REACH, FrankaKitchen
from earl_jax.report.tables import write

FREE = np.array([[-0.6, 0.0, 2.0], [-0.1, 0.25, 2.5]])
"""Bounds [m] of mocap positions at which the hand touches nothing."""
STEPS = 300
NEARLY = 0.03
"""Remaining distance (rad, m) at which a script's object counts as moved."""
BACK = 0.1
"""Position along y to which the hand withdraws, in metres."""


class Script(NamedTuple):
    """Waypoints [w, 3] of the mocap body, the index in a state of the object that it moves, and its start and goal."""

    waypoints: tuple[tuple[float, float, float], ...]
    index: int
    start: float
    goal: float
    steps: int = 240


SCRIPTS = {
    "close microwave": Script(((-0.68, -0.1, 2.2), (-0.68, -0.1, 1.82), (-0.68, 0.34, 1.82)), 22, -0.7, 0.0),
    "close right hinge": Script(
        ((-0.2, 0.0, 2.1), (0.05, 0.0, 2.1), (0.05, 0.06, 2.55), (-0.3, 0.1, 2.55), (-0.42, 0.25, 2.55), (-0.42, 0.46, 2.55)),
        21, 1.45, 0.0,
    ),
    "close slide": Script(((0.0, 0.0, 2.2), (0.36, 0.1, 2.55), (0.36, 0.36, 2.55), (-0.14, 0.36, 2.55)), 19, 0.37, 0.0),
    "close light": Script(((-0.52, 0.2, 2.28), (-0.52, 0.38, 2.28), (-0.36, 0.38, 2.28)), 17, -0.69, 0.0),
    "open slide": Script(((-0.22, 0.1, 2.55), (-0.22, 0.36, 2.55), (0.36, 0.36, 2.55)), 19, 0.0, 0.37),
    "open light": Script(((-0.28, 0.2, 2.28), (-0.28, 0.38, 2.28), (-0.52, 0.38, 2.28)), 17, 0.0, -0.69),
    "turn burner": Script(
        ((-0.2, 0.2, 2.27), (-0.2, 0.39, 2.27), (-0.1, 0.39, 2.27), (-0.07, 0.39, 2.18)), 9, 0.0, -1.57,
    ),
    "open microwave": Script(
        ((-0.6, 0.0, 2.0), (-0.6, 0.0, 1.85), (-0.6, 0.33, 1.85), (-0.675, 0.33, 1.85), (-0.675, 0.05, 1.85), (-0.7, -0.1, 1.85)),
        22, 0.0, -0.7,
    ),
    "open right hinge": Script(
        ((-0.6, 0.1, 2.3), (-0.6, 0.1, 2.55), (-0.6, 0.39, 2.55), (-0.35, 0.39, 2.55), (0.1, 0.07, 2.55), (0.2, -0.03, 2.55)),
        21, 0.0, 1.45,
    ),
    "turn bottom burner": Script(
        ((-0.33, 0.2, 2.27), (-0.33, 0.4, 2.27), (-0.26, 0.4, 2.27), (-0.26, 0.4, 2.25)), 11, 0.0, -0.88,
    ),
}  # fmt: skip


def start_state(env: FrankaKitchen, script: Script) -> State:
    """Return a state after a reset in which all objects are closed, except that of `script`, which is at its start."""
    state = env.reset(jax.random.key(0))
    objects = jnp.zeros(len(kitchen_reward.FIRST) - kitchen_reward.ROBOT)
    objects = jnp.where(kitchen_reward.FIRST[kitchen_reward.ROBOT :] == script.index, script.start, objects)
    qpos = jnp.concatenate([state.data.qpos[: kitchen_reward.ROBOT], objects])
    return state.replace(data=state.data.replace(qpos=qpos))


def act(script: Script, state: State, stage: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Return the action [9] and the number of the next waypoint; the hand withdraws along y when the object is moved."""
    waypoints, mocap = jnp.array(script.waypoints), state.data.mocap_pos[0]
    stage = jnp.where(
        jnp.linalg.norm(waypoints[stage] - mocap) < 2e-3, jnp.minimum(stage + 1, len(waypoints) - 1), stage
    )
    left = (script.goal - kitchen_reward.observed(state.data.qpos)[script.index]) * np.sign(script.goal - script.start)
    target = jnp.where(left < NEARLY, jnp.minimum(mocap, jnp.array([np.inf, BACK, np.inf])), waypoints[stage])
    return jnp.append(jnp.clip((target - mocap) / REACH, -1.0, 1.0), jnp.zeros(6)), stage


def play(env: FrankaKitchen, script: Script) -> tuple[jax.Array, State]:
    """Return the position [T] of the moved object after each step, without noise, and the last state."""

    def step(carry: tuple[State, jax.Array], _: None) -> tuple[tuple[State, jax.Array], jax.Array]:
        action, stage = act(script, *carry)
        state = env.step(carry[0], action)
        return (state, stage), kitchen_reward.observed(state.data.qpos)[script.index]

    first = (start_state(env, script), jnp.zeros((), jnp.int32))
    (state, _), moved = jax.lax.scan(step, first, length=script.steps)
    return moved, state


def scripts() -> list[dict[str, Any]]:
    """Return one row per script, on engine c: the final position of its object, and the distance to its goal."""
    env, rows = make("franka_kitchen", engine="c"), []
    for name, script in SCRIPTS.items():
        moved, state = jax.jit(lambda script=script: play(env, script))()
        end = float(moved[-1])
        rows.append(
            {
                "script": name, "start": script.start, "goal": script.goal, "end": round(end, 4),
                "error": round(abs(end - script.goal), 4), "steps": script.steps, "fault": bool(env.fault(state)),
            }
        )  # fmt: skip
        print(json.dumps(rows[-1]), flush=True)
    return rows


def original_arm(file: Path, old_weld: bool = True) -> mujoco.MjModel:
    """Return the original's model without geoms, from its compiled numbers in `file`.

    `old_weld` gives the flange the single inverse weight of MuJoCo up to 2.3, which the original used; without it the weld's
    rotation is as MuJoCo 4 compiles it.
    """
    compiled = json.loads(file.read_text())
    spec, bodies = mujoco.MjSpec(), {}
    spec.compiler.degree = False
    spec.option.timestep, spec.option.iterations = compiled["opt"]["timestep"], compiled["opt"]["iterations"]
    spec.option.cone, spec.option.solver = mujoco.mjtCone.mjCONE_PYRAMIDAL, mujoco.mjtSolver.mjSOL_NEWTON
    for row in compiled["bodies"][1:]:
        parent = bodies.get(row["parent"] or "base", spec.worldbody)
        body = parent.add_body(name=row["name"] or "base", pos=row["pos"], quat=row["quat"], mocap=row["mocap"] >= 0)
        if row["mass"]:
            body.mass, body.ipos, body.iquat, body.inertia = row["mass"], row["ipos"], row["iquat"], row["inertia"]
            body.explicitinertial = True
        bodies[body.name] = body
    kinds = {"hinge": mujoco.mjtJoint.mjJNT_HINGE, "slide": mujoco.mjtJoint.mjJNT_SLIDE}
    for row in compiled["joints"]:
        joint = bodies[row["body"]].add_joint(name=row["name"], type=kinds[row["type"]], axis=row["axis"])
        joint.limited, joint.range = mujoco.mjtLimited.mjLIMITED_TRUE, row["range"]
        joint.damping, joint.armature, joint.frictionloss = [row["damping"], 0, 0], row["armature"], row["frictionloss"]
    for row in compiled["sites"]:
        if row["name"] == "end_effector":
            bodies[row["body"]].add_site(name="tip", pos=row["pos"])
    for row in compiled["equality"]:
        _couple(spec, row)
    for row in compiled["actuators"]:
        motor = spec.add_actuator(name=row["name"], target=row["trn"], trntype=mujoco.mjtTrn.mjTRN_JOINT)
        motor.set_to_position(kp=row["gain"][0])
        motor.ctrlrange, motor.forcerange = row["ctrlrange"], row["forcerange"]
        motor.ctrllimited = motor.forcelimited = mujoco.mjtLimited.mjLIMITED_TRUE
    model = spec.compile()
    if old_weld:
        model.body_invweight0[model.body("panda0_link7").id] = model.body_invweight0[model.body("panda0_link7").id][0]
    return model


def _couple(spec: Any, row: dict[str, Any]) -> None:
    welded = row["type"] == mujoco.mjtEq.mjEQ_WELD
    equality = spec.add_equality(name1=row["n1"], name2=row["n2"], solref=row["solref"], solimp=row["solimp"])
    equality.type = mujoco.mjtEq.mjEQ_WELD if welded else mujoco.mjtEq.mjEQ_JOINT
    equality.objtype = mujoco.mjtObj.mjOBJ_BODY if welded else mujoco.mjtObj.mjOBJ_JOINT
    equality.data[: len(row["data"]) - 1] = row["data"][: equality.data.size][: len(row["data"]) - 1]


def paths() -> dict[str, np.ndarray]:
    """Return mocap positions [300, 3] per step: sinusoids of 60 to 160 steps per axis, and walks between random waypoints."""
    rng, by_name = np.random.default_rng(0), {}
    for number in range(4):
        period, phase = rng.uniform(60, 160, 3), rng.uniform(0, 2 * np.pi, 3)
        wave = np.sin(2 * np.pi * np.arange(STEPS)[:, None] / period + phase)
        by_name[f"sinusoid {number}"] = _follow_waypoints(FREE.mean(axis=0) + np.ptp(FREE, axis=0) / 2 * wave)
        corners = np.repeat(rng.uniform(*FREE, (STEPS // 10, 3)), 30, axis=0)[:STEPS]
        by_name[f"walk {number}"] = _follow_waypoints(corners)
    return by_name


def _follow_waypoints(targets: np.ndarray) -> np.ndarray:
    """Return the positions of a mocap body that follows `targets [T, 3]`, at most `REACH` per step and axis."""
    position, positions = np.array(MIDDLE), []
    for target in targets:
        position = np.clip(position + np.clip(target - position, -REACH, REACH), MOCAP_LOW, MOCAP_HIGH)
        positions.append(position)
    return np.array(positions)


def follow(model: mujoco.MjModel, path: np.ndarray, substeps: int = 40) -> np.ndarray:
    """Return the tip positions [T, 3] of the original's arm, dragged along `path [T, 3]` from the pose of our reset."""
    data, tips = mujoco.MjData(model), []
    data.qpos[: len(ARM_QPOS)], data.qvel[: len(ARM_QVEL)] = ARM_QPOS, ARM_QVEL
    for position in path:
        data.mocap_pos[0] = position
        mujoco.mj_step(model, data, substeps)
        mujoco.mj_kinematics(model, data)
        tips.append(data.site("tip").xpos.copy())
    return np.array(tips)


def follow_ours(env: FrankaKitchen, paths: np.ndarray) -> np.ndarray:
    """Return our tip positions [n, T, 3] along `paths [n, T, 3]`, in the task itself with all objects closed."""
    state = env.reset(jax.random.key(0))
    qpos = state.data.qpos.at[kitchen_reward.ROBOT :].set(0.0)
    state = state.replace(data=state.data.replace(qpos=qpos))

    def follow_path(path: jax.Array) -> jax.Array:
        def step(state: State, position: jax.Array) -> tuple[State, jax.Array]:
            move = jnp.append((position - state.data.mocap_pos[0]) / REACH, jnp.zeros(6))
            state = env.step(state, move)
            return state, state.data.qpos

        return jax.lax.scan(step, state, path)[1]

    joints, model = (
        np.asarray(jax.jit(jax.vmap(follow_path))(jnp.asarray(paths, jnp.float32))),
        physics.load_model(env.name),
    )
    return np.array([[_tip(model, row) for row in rows] for rows in joints])


def _tip(model: mujoco.MjModel, qpos: np.ndarray) -> np.ndarray:
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_kinematics(model, data)
    return data.site("tip").xpos.copy()


def motion(file: Path) -> list[dict[str, Any]]:
    """Return one row per path, substeps and weld of the original: the error of our tip in millimetres."""
    named_paths, rows = paths(), []
    for old_weld in (True, False):
        theirs = {name: follow(original_arm(file, old_weld), path) for name, path in named_paths.items()}
        for substeps in (12, 40):
            env = make("franka_kitchen", engine="c", substeps=substeps, noise=False)
            ours = follow_ours(env, np.array(list(named_paths.values())))
            for name, tips in zip(named_paths, ours, strict=True):
                error = 1e3 * np.linalg.norm(tips - theirs[name], axis=1)
                rows.append(
                    {
                        "path": name, "original_weld": "MuJoCo 2" if old_weld else "MuJoCo 4", "our_substeps": substeps,
                        "rmse_mm": round(float(np.sqrt((error**2).mean())), 2), "max_mm": round(float(error.max()), 2),
                    }
                )  # fmt: skip
                print(json.dumps(rows[-1]), flush=True)
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=["scripts", "motion"])
    parser.add_argument("file", type=Path, nargs="?", help="the original's compiled model, for motion")
    arguments = parser.parse_args()
    if (arguments.what == "motion") != (arguments.file is not None):
        parser.error("motion takes one file, scripts takes none")
    out = RESULTS / "kitchen" / arguments.what
    out.parent.mkdir(parents=True, exist_ok=True)
    rows = scripts() if arguments.what == "scripts" else motion(arguments.file)
    command = " ".join(
        ["python -m benchmarks.physics.kitchen", arguments.what, arguments.file.name if arguments.file else ""]
    )
    write(rows, out.with_suffix(".csv"))
    save(out.with_suffix(".json"), command.strip(), {"rows": rows})


if __name__ == "__main__":
    main()
