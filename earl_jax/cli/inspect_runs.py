"""Commands that inspect runs: evaluate, plot, table, compare."""

from pathlib import Path
from typing import Literal

from earl_jax.cli.arguments import JSON, Engine, Positional, emit


def evaluate(
    folder: Positional[Path],
    episodes: int = 100,
    seed: int = 0,
    starts: Literal["initial", "uniform", "wide"] = "initial",
    engine: Engine = None,
    json: JSON = False,
) -> None:
    """Evaluate the newest policies of a run on fresh greedy episodes.

    Args:
        folder: Run folder with policies.npz or a checkpoint.
        episodes: Episodes for the policy of each seed.
        seed: Random seed of the starts and goals.
        starts: Initial states of the episodes: those of the task, uniform over the workspace, or wide.
    """
    from earl_jax import training

    metrics = training.evaluate(folder, episodes, seed, engine, starts)
    lines = [
        f"{name}: mean {values.mean():.3f}  per seed {values.round(3).tolist()}" for name, values in metrics.items()
    ]
    emit({name: values.tolist() for name, values in metrics.items()}, json, "\n".join(lines))


def plot(folders: Positional[tuple[Path, ...]], out: Path = Path("curves.png"), metric: str | None = None) -> None:
    """Plot the deployed and continuing curves of runs, one line per method, with 95 % bands.

    Args:
        folders: Run folders.
        out: Picture to write: .png, .pdf or .svg.
        metric: Column of metrics.csv to draw in the place of the deployed score. By default none.
    """
    from earl_jax.report.plots import plot_runs

    print(plot_runs(folders, out, metric))


def table(folders: Positional[tuple[Path, ...]], last: int = 1, out: Path | None = None, json: JSON = False) -> None:
    """Print the paper's two tables for runs, with the published figures if there are any.

    Args:
        folders: Run folders.
        last: Number of final evaluations to average. The paper's tables use 1.
        out: File that also receives the table: .md, .tex or .csv. By default none.
    """
    from earl_jax.report.tables import markdown, tabulate, write

    rows = tabulate(folders, last)
    if out:
        write(rows, out)
    emit({"rows": rows}, json, markdown(rows))


def compare(
    folders: Positional[tuple[Path, ...]],
    against: Literal["runs", "published"] = "runs",
    metric: str | None = None,
    out: tuple[Path, ...] = (),
    json: JSON = False,
) -> None:
    """Test the differences of deployed scores between runs of a task, or from the published scores.

    Args:
        folders: Run folders; seeds of the same task, method and options are pooled.
        against: Compare each pair of runs on a task, or each run with the paper's five seeds.
        metric: Column of metrics.csv to test, such as deployed/success_wide. By default the deployed score.
        out: Files that also receive the comparison: .md, .tex, .csv, .png, .pdf or .svg. By default none.
    """
    from earl_jax.report.comparison import compare as compare_runs
    from earl_jax.report.comparison import table_text, write_comparison

    rows = compare_runs(folders, against, metric)
    for path in out:
        write_comparison(rows, path)
    emit({"rows": rows}, json, table_text(rows))
