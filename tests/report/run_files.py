"""Run folders with metrics written by hand, and readers of the files that reports make of them."""

import csv
import json

import numpy as np
from matplotlib.colors import to_rgb
from matplotlib.image import imread

from earl_jax.algos import make_algo
from earl_jax.envs import make
from earl_jax.runs.folder import RunFolder
from tests.conftest import make_config

TABLETOP, DOOR, KITCHEN, MINITAUR = "tabletop_organization", "sawyer_door", "franka_kitchen", "minitaur_pen"


def write_run(
    path, env, algo, deployed, steps=(), seeds=(), planned=None, setting=None, env_options=(), metrics=(), **options
):
    """Write a run whose seeds score `deployed [N, E]` at `steps [E]`, and return its path.

    Steps are 10, 20, ... by default; `planned` is the number in the config. `metrics` holds further metrics, each of
    which broadcasts to [N, E].
    """
    scores = np.asarray(deployed, float)
    steps = list(steps or range(10, 10 * scores.shape[1] + 1, 10))
    lengths = {"steps": planned or steps[-1], "eval_every": steps[0], "checkpoint_every": 10}
    task, method, lanes = make(env, **dict(env_options)), make_algo(algo, **options), seeds or range(len(scores))
    config = make_config(task, method, tuple(lanes), setting, **lengths)
    folder = RunFolder.create(path, config, engine="kinematic")
    values = {"deployed/success": scores, "deployed/return": scores, **dict(metrics)}
    columns = {name: np.broadcast_to(value, scores.shape) for name, value in values.items()}
    for number, step in enumerate(steps):
        folder.append(step, {name: column[:, number] for name, column in columns.items()})
    return path


def rising(seeds, evaluations, top=1.0):
    """Return scores [seeds, evaluations] that rise to `top`, each seed 0.1 below the one before."""
    return np.outer(top - 0.1 * np.arange(seeds), np.linspace(0, 1, evaluations))


def constant(*scores):
    """Return scores [N, 2] that stay the same over two evaluations."""
    return np.repeat(np.array(scores, float)[:, None], 2, axis=1)


def write_page_run(path, algo, deployed, env=TABLETOP, extra_counts=(), metrics=(), **options):
    """Write a run with every metric that a page needs: rewards a hundredth of the scores, and counts of evaluations."""
    scores = np.asarray(deployed, float)
    rewards = dict.fromkeys(("continuing/reward", "continuing/recent"), scores / 100)
    counts = dict.fromkeys(("interventions", "faults", "reached", *extra_counts), np.arange(1, scores.shape[1] + 1))
    return write_run(path, env, algo, scores, metrics={**rewards, **counts, **dict(metrics)}, **options)


def change_config(run, **values):
    """Write `values` to the config.json of `run`; None removes an entry."""
    file = run / "config.json"
    changed = {**json.loads(file.read_text()), **values}
    file.write_text(json.dumps({name: value for name, value in changed.items() if value is not None}))


def read_csv(path):
    with path.open() as handle:
        return list(csv.DictReader(handle))


def count_pixels(picture, colour):
    """Return the number of pixels of a picture that have `colour`."""
    return int((np.abs(imread(picture)[..., :3] - to_rgb(colour)) < 0.01).all(axis=-1).sum())
