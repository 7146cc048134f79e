"""Runs of every artefact, written by hand."""

from earl_jax.protocol import Deployment
from tests.report.run_files import DOOR, KITCHEN, TABLETOP, constant, write_run

PEG, CHEETAH, FISH = "sawyer_peg", "cheetah_run", "fish_swim"
SCORES = [[0.2, 1.0], [0.4, 0.6]]
LATE = [[0.0, 1.0], [0.0, 0.8], [0.0, 0.6], [0.0, 0.8], [0.0, 1.0]]
SHORT, LONG = {"train_horizon": 1_000}, {}
"""Options of a task with a short and with its own H_T, which is 100,000 steps."""


def rewards(lifetime=0.0, **options):
    return {"metrics": {"continuing/reward": lifetime}, **options}


def lifetimes(interventions, chance=0.0, **helped):
    """Return the options of a run with the counts at its end, with a budget of 10 if it was `helped`."""
    setting = Deployment(intervention_chance=chance, budget=10.0 if helped else None)
    return {"setting": setting, "metrics": {"interventions": interventions, **helped}}


RUNS = {
    "figure5": [
        (TABLETOP, "fbrl", SCORES, rewards(0.004, steps=(100_000, 200_000))),
        (KITCHEN, "oracle", [[100.0, 300.0]], rewards(steps=(20, 40))),
    ],
    "table1": [
        (KITCHEN, "naive", constant(-2500.0, -2900.0), rewards()),
        (TABLETOP, "naive", [[0.0, 0.7], [0.4, 0.9]], rewards()),
        (TABLETOP, "fbrl", constant(0.7, 0.8), rewards()),
        (TABLETOP, "fbrl", constant(0.5), rewards(reward_scale=1.0)),
        (DOOR, "oracle", constant(0.9, 1.0), rewards()),
    ],
    "figure2": [
        (CHEETAH, "naive", constant(500.0, 510.0, 520.0), {"env_options": SHORT, "timeout_bootstrap": True}),
        (CHEETAH, "naive", constant(100.0, 110.0, 120.0), {"env_options": LONG, "timeout_bootstrap": True}),
        (CHEETAH, "naive", constant(500.0, 500.0, 500.0), {"env_options": SHORT, "timeout_bootstrap": False}),
        (CHEETAH, "naive", constant(480.0, 505.0, 530.0), {"env_options": LONG, "timeout_bootstrap": False}),
        (FISH, "naive", constant(7.0, 8.0, 9.0), {"env_options": SHORT, "timeout_bootstrap": [False, True, True]}),
    ],
    "tradeoff": [
        (TABLETOP, "naive", LATE, lifetimes(300, chance=0.01)),
        (TABLETOP, "naive", [[0.0, 0.0, 1.0]] * 5, lifetimes(5)),
        (TABLETOP, "fbrl", constant(0.1, 0.3), lifetimes(5, chance=0.01)),
        (TABLETOP, "fbrl", constant(0.1, 0.3), lifetimes(5, **{"help/asked": 6, "help/enforced": 4, "help/over": 1})),
        (DOOR, "naive", constant(0.1), lifetimes(5)),
        (DOOR, "naive", constant(0.2), lifetimes(6, chance=0.01)),
    ],
}
"""The runs of an artefact: task, method, scores [N, E] and options."""


def write_runs(root, runs):
    return [write_run(root / str(n), *run, **options) for n, (*run, options) in enumerate(runs)]


def numbers(row, *names):
    return [float(row[name]) for name in names]
