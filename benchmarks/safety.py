"""Apply random and saturated actions until something breaks: `python -m benchmarks.safety sawyer_peg --steps 20000 --lanes 64`.

A third of the lanes each act uniformly, at random corners of the action box, and at corners held for up to 50 steps. The report
counts faults and states that are not finite. After every control step it measures the penetration of each pair of geoms, the
distance of each joint beyond its limits, and the distance of each free body from the origin. Prints one JSON line and writes it
to --out.
"""

import argparse
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from benchmarks.output import emit
from benchmarks.physics import ENVS, make_task
from earl_jax import physics
from earl_jax.physics.engine_choice import ENGINES

BLOCK = 500
LONGEST_HOLD = 50
LIMIT_MM = 15.0


def make_actions(steps: int, lanes: int, size: int, seed: int = 0) -> np.ndarray:
    """Return actions [steps, lanes, size]: uniform, corners, and corners held, a third of the lanes each."""
    rng = np.random.default_rng(seed)
    uniform = rng.uniform(-1, 1, (steps, lanes, size))
    corners = np.sign(rng.uniform(-1, 1, (steps, lanes, size)))
    held = corners.copy()
    for lane in range(lanes):
        holds = rng.integers(1, LONGEST_HOLD + 1, steps)
        starts = np.cumsum(holds)[np.cumsum(holds) < steps]
        held[:, lane] = corners[
            np.concatenate([[0], starts])[np.searchsorted(starts, np.arange(steps), side="right")], lane
        ]
    kind = np.arange(lanes) % 3
    return np.select([(kind == 0)[None, :, None], (kind == 1)[None, :, None]], [uniform, corners], held).astype(
        np.float32
    )


def run_blocks(env: Any, actions: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield qpos [BLOCK, lanes, nq] and faults [BLOCK, lanes] block by block; a faulty lane is reset, as in training."""

    def step(state, action_and_key):
        action, key = action_and_key
        after = jax.vmap(env.step)(state, action)
        fault = jax.vmap(env.fault)(after)
        fresh = jax.vmap(env.reset)(jax.random.split(key, len(fault)))

        def pick(new, old):
            return jnp.where(fault.reshape(-1, *(1,) * (new.ndim - 1)), new, old)

        return jax.tree.map(pick, fresh, after), (after.data.qpos, fault)

    advance = jax.jit(lambda state, block, keys: jax.lax.scan(step, state, (block, keys)))
    state = jax.jit(jax.vmap(env.reset))(jax.random.split(jax.random.key(0), actions.shape[1]))
    for first in range(0, len(actions), BLOCK):
        keys = jax.random.split(jax.random.key(1 + first), BLOCK)
        state, (qpos, fault) = advance(state, jnp.asarray(actions[first : first + BLOCK]), keys)
        yield np.asarray(qpos), np.asarray(fault)


def update_penetration(
    model: Any, data: Any, qpos: np.ndarray, worst: dict[str, float], counts: dict[str, int]
) -> None:
    """Update over qpos [n, nq] each pair's `worst` depth in mm and its `counts` of contacts beyond the limit."""
    for row in qpos:
        data.qpos[:] = row
        mujoco.mj_kinematics(model, data)
        mujoco.mj_collision(model, data)
        for contact in data.contact:
            depth = -1e3 * contact.dist
            pair = f"{model.geom(contact.geom1).name} - {model.geom(contact.geom2).name}"
            worst[pair] = max(worst.get(pair, 0.0), float(depth))
            counts[pair] = counts.get(pair, 0) + (depth > LIMIT_MM)


def limit_excess(model: Any, qpos: np.ndarray) -> np.ndarray:
    """Return how far [njnt] each joint passes its limits (rad or m) over `qpos [n, nq]`, 0 for those without."""
    limited = model.jnt_limited.astype(bool) & (model.jnt_type >= int(mujoco.mjtJoint.mjJNT_SLIDE))
    joints = qpos[:, model.jnt_qposadr]
    excess = np.maximum(model.jnt_range[:, 0] - joints, joints - model.jnt_range[:, 1]).max(axis=0)
    return np.where(limited, np.maximum(excess, 0.0), 0.0)


def largest_distance(model: Any, qpos: np.ndarray) -> float:
    """Return the largest |x| or |y| of any free body [m] over `qpos [n, nq]`, 0 where there is none."""
    starts = model.jnt_qposadr[model.jnt_type == int(mujoco.mjtJoint.mjJNT_FREE)]
    return max((float(np.abs(qpos[:, start : start + 2]).max()) for start in starts), default=0.0)


def run(name: str, steps: int, lanes: int, engine: str, substeps: int | None) -> dict[str, Any]:
    """Return the report on one task."""
    env, worst, counts = make_task(name, engine, substeps), {}, {}
    model = physics.load_model(env.model)
    data, broken, faults, reach, past = mujoco.MjData(model), 0, 0, 0.0, np.zeros(model.njnt)
    for block, fault in run_blocks(env, make_actions(steps, lanes, env.action_size)):
        qpos = block[np.isfinite(block).all(axis=-1)]
        broken += block.shape[0] * block.shape[1] - len(qpos)
        faults += int(fault.sum())
        past, reach = np.maximum(past, limit_excess(model, qpos)), max(reach, largest_distance(model, qpos))
        update_penetration(model, data, qpos, worst, counts)
    return {
        "env": name, "engine": env.resolved_engine, "substeps": env.substeps, "steps": steps, "lanes": lanes,
        "not_finite": broken, "faults": faults,
        "worst_penetration_mm": round(max(worst.values(), default=0.0), 2),
        "contacts_over_limit": int(sum(counts.values())),
        "past_limit_by_joint": {model.joint(i).name: round(float(past[i]), 4) for i in np.argsort(-past) if past[i] > 0},
        "free_body_farthest_m": round(reach, 3),
        "by_pair_mm": {pair: round(depth, 2) for pair, depth in sorted(worst.items(), key=lambda item: -item[1])},
    }  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("env", choices=ENVS)
    parser.add_argument("--steps", type=int, default=20_000)
    parser.add_argument("--lanes", type=int, default=64)
    parser.add_argument("--engine", choices=["auto", *ENGINES], default="auto")
    parser.add_argument("--substeps", type=int, help="other than the task's own")
    parser.add_argument("--out", type=Path)
    arguments = parser.parse_args()
    if arguments.steps % BLOCK:
        parser.error(f"--steps must be a multiple of {BLOCK}")
    report = run(arguments.env, arguments.steps, arguments.lanes, arguments.engine, arguments.substeps)
    command = f"python -m benchmarks.safety {arguments.env} --steps {arguments.steps} --lanes {arguments.lanes}"
    emit(report, arguments.out, f"{command} --substeps {report['substeps']}")


if __name__ == "__main__":
    main()
