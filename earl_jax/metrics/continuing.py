"""Continuing evaluation: the reward of a lifetime, and the number of interventions in it."""

from collections.abc import Iterable, Mapping

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from earl_jax.envs import Env, State
from earl_jax.metrics.phase_stats import PhaseStats, init_phase_stats, phase_metrics

DIVERGED = "diverged"
"""The metric that is 1 in a lane with a loss or a parameter that is not finite, else 0."""

OVER = "help/over"
"""The metric that is 1 in a lane whose lifetime has ended with its budget, else 0."""
HELP = ("asked", "enforced", "budget")
"""Keys of `info` in a state of a `HelpBudget`."""


class Counters(struct.PyTreeNode):
    """Counts of one lane since its first step.

    `window_reward`: task reward since the last evaluation; `total_reward`: task reward before that; `interventions`:
    number of interventions; `faults`: those of them that followed a broken simulation; `reached`: task goals reached;
    `diagnostics`: scalars of the last gradient step; `phases`: phases that ended, and the object's movement.
    """

    window_reward: jax.Array
    total_reward: jax.Array
    interventions: jax.Array
    faults: jax.Array
    reached: jax.Array
    diagnostics: dict[str, jax.Array]
    phases: PhaseStats


def init_counters(env: Env, env_state: State, diagnostics: Iterable[str] = ()) -> Counters:
    """Return the counters of a lane that starts in `env_state`; `diagnostics` names those of the learner."""
    zero, none = jnp.zeros(()), jnp.zeros((), jnp.int32)
    return Counters(
        window_reward=zero,
        total_reward=zero,
        interventions=none,
        faults=none,
        reached=none,
        diagnostics=dict.fromkeys(diagnostics, zero),
        phases=init_phase_stats(env, env_state),
    )


def continuing(
    counters: Counters, env: Env, state: State, step: jax.Array, window: jax.Array | int, alive_steps: int, phases: int
) -> tuple[Counters, dict[str, jax.Array]]:
    """Return the counters with a new window, and one lane's metrics after `step` steps, of which `window` are recent.

    `continuing/reward` is the paper's metric: task reward averaged over the lifetime, whichever controller acted.
    `continuing/recent` is the same since the last evaluation. `interventions`, `faults` (resets after a broken
    simulation, which count as interventions) and `reached` are counts since the first step. In a `HelpBudget`
    environment, `help/asked` and `help/enforced` count its own interventions, `help/budget` is the remaining budget,
    and `help/over` is 1 if the lifetime has ended. `phase_metrics` returns the others.
    """
    total = counters.total_reward + counters.window_reward
    metrics = {
        "continuing/reward": total / jnp.maximum(step, 1).astype(jnp.float32),
        "continuing/recent": counters.window_reward / jnp.maximum(window, 1).astype(jnp.float32),
        "interventions": counters.interventions,
        "faults": counters.faults,
        "reached": counters.reached,
    }
    if state.info.keys() >= {*HELP}:
        metrics |= {f"help/{name}": state.info[name] for name in HELP}
        metrics[OVER] = state.done
    stats, of_phases = phase_metrics(counters.phases, step, alive_steps, phases, env.sparse)
    counters = counters.replace(total_reward=total, window_reward=jnp.zeros_like(total), phases=stats)
    return counters, metrics | of_phases


def count_diverged(metrics: Mapping[str, np.ndarray]) -> int:
    """Return the number of seeds in `metrics`, arrays [N, E], that have diverged by the last evaluation.

    In published runs, which have no metric `diverged`, only the loss shows divergence.
    """
    marks = [metrics[DIVERGED][:, -1] > 0] if DIVERGED in metrics else []
    marks += [~np.isfinite(metrics["critic_loss"][:, -1])] if "critic_loss" in metrics else []
    return int(np.any(marks, axis=0).sum())


def mostly_faults(faults: np.ndarray, steps: int) -> np.ndarray:
    """Return whether more than half of the `steps` of each lane were `faults [N]`, bool [N]."""
    return faults > steps / 2


def diverged_text(diverged: int, seeds: int) -> str:
    """Return `, 2 of 5 diverged`, or nothing if no seed has diverged."""
    return f", {diverged} of {seeds} diverged" if diverged else ""
