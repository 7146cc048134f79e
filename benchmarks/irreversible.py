"""Test whether irreversible states are ever left: `python -m benchmarks.irreversible sawyer_peg --steps 20000`.

The lanes run without interventions (only a fault resets a lane, as in training) under the actions of `benchmarks.safety`. The
report counts lanes that reach a state for which `Env.irreversible` is true, their steps after that, and how many of those steps
were outside such states. Prints one JSON line and writes it to --out.
"""

import argparse
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks.output import emit
from benchmarks.safety import make_actions
from earl_jax.envs import make

ENVS = ("sawyer_peg", "dhand_lightbulb", "minitaur_pen")


def run_lanes(name: str, steps: int, lanes: int) -> tuple[np.ndarray, np.ndarray]:
    """Return bool [steps, lanes]: which states were irreversible, and which were faults."""
    env = make(name)

    def step(state, action_and_key):
        action, key = action_and_key
        after = jax.vmap(env.step)(state, action)
        fault, stuck = jax.vmap(env.fault)(after), jax.vmap(env.irreversible)(after)
        fresh = jax.vmap(env.reset)(jax.random.split(key, lanes))
        state = jax.tree.map(
            lambda new, old: jnp.where(fault.reshape(-1, *(1,) * (new.ndim - 1)), new, old), fresh, after
        )
        return state, (stuck, fault)

    state = jax.vmap(env.reset)(jax.random.split(jax.random.key(0), lanes))
    inputs = jnp.asarray(make_actions(steps, lanes, env.action_size)), jax.random.split(jax.random.key(1), steps)
    _, (stuck, fault) = jax.jit(lambda state, inputs: jax.lax.scan(step, state, inputs))(state, inputs)
    return np.asarray(stuck), np.asarray(fault)


def report(name: str, steps: int, lanes: int) -> dict[str, Any]:
    """Return the counts for one task: a lane counts from its first irreversible state to its next fault or the end."""
    stuck, fault = run_lanes(name, steps, lanes)
    entered, after, outside, out_at_the_end = 0, 0, 0, 0
    for lane in range(lanes):
        first = np.flatnonzero(stuck[:, lane] & ~fault[:, lane])
        if len(first):
            ends = np.flatnonzero(fault[first[0] :, lane])
            rest = stuck[first[0] + 1 : first[0] + (ends[0] if len(ends) else steps), lane]
            entered, after, outside = entered + 1, after + len(rest), outside + int((~rest).sum())
            out_at_the_end += bool(len(rest) and not rest[-1])
    return {
        "env": name, "steps": steps, "lanes": lanes, "faults": int(fault.sum()), "lanes_entered": entered,
        "steps_after_entering": after, "of_them_outside": outside, "lanes_outside_at_the_end": out_at_the_end,
    }  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("env", choices=ENVS)
    parser.add_argument("--steps", type=int, default=20_000)
    parser.add_argument("--lanes", type=int, default=32)
    parser.add_argument("--out", type=Path)
    arguments = parser.parse_args()
    command = f"python -m benchmarks.irreversible {arguments.env} --steps {arguments.steps} --lanes {arguments.lanes}"
    emit(report(arguments.env, arguments.steps, arguments.lanes), arguments.out, command)


if __name__ == "__main__":
    main()
