"""Commands that look at what there is and at what was trained: list, evaluate, plot, table."""

from pathlib import Path
from typing import Literal

from earl_jax.cli.arguments import JSON, Physics, Positional, say


def list_(json: JSON = False) -> None:
    """Show the tasks and methods by name."""
    from earl_jax import algos, envs

    names = {"envs": envs.list_envs(), "algos": algos.list_algos()}
    say(names, json, "\n".join(f"{kind}: {', '.join(values)}" for kind, values in names.items()))


def evaluate(
    folder: Positional[Path],
    episodes: int = 100,
    seed: int = 0,
    starts: Literal["initial", "uniform"] = "initial",
    physics: Physics = None,
    json: JSON = False,
) -> None:
    """Evaluate the newest policies of a run on fresh greedy episodes.

    Args:
        folder: a run folder with a checkpoint.
        episodes: episodes for each seed's policy.
        seed: of starts and goals.
        starts: where episodes begin: where the task's do, or anywhere in the workspace.
    """
    from earl_jax.training import evaluate as measure

    results = measure(folder, episodes, seed, physics, starts)
    lines = [
        f"{name}: mean {values.mean():.3f}  per seed {values.round(3).tolist()}" for name, values in results.items()
    ]
    say({name: values.tolist() for name, values in results.items()}, json, "\n".join(lines))


def plot(folders: Positional[tuple[Path, ...]], out: Path = Path("curves.png")) -> None:
    """Draw deployed and continuing curves of runs, one line a method, with 95 % bands.

    Args:
        folders: run folders.
        out: the picture, .png, .pdf or .svg.
    """
    from earl_jax.report.plots import plot_runs

    print(plot_runs(folders, out))


def table(folders: Positional[tuple[Path, ...]], last: int = 1, out: Path | None = None, json: JSON = False) -> None:
    """Print the paper's two tables for runs, beside the published figures where there are any.

    Args:
        folders: run folders.
        last: evaluations averaged at the end of each run; the paper's tables use 1.
        out: also write the table here, .md or .csv.
    """
    from earl_jax.report.tables import markdown, tabulate, write

    rows = tabulate(folders, last)
    if out:
        write(rows, out)
    say({"rows": rows}, json, markdown(rows))
