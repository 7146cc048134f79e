"""Commands that inspect runs: show, evaluate, plot, table, best, compare, report."""

import contextlib
import itertools
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from earl_jax.cli.arguments import Positional, Texts, emit, replacing
from earl_jax.errors import InputError, printable
from earl_jax.options.values import counted

if TYPE_CHECKING:
    import numpy as np

    from earl_jax.report.runs import Curves
    from earl_jax.training import Result


def show(folder: Positional[Path], last: int | None = None, window: int | None = None, json: bool = False) -> None:
    """Show a run: its task, method and options, the steps it has reached, its newest metrics, and its policies.

    Args:
        folder: Run folder. No checkpoint is needed.
    """
    from earl_jax.metrics.scores import Window
    from earl_jax.report.runs import part_scores, parts
    from earl_jax.training.loading import policies_at
    from earl_jax.training.result import load

    result, chosen = load(folder), Window(last, window)
    run, own = result.folder, parts(result, chosen)
    assert run is not None
    values = {
        "folder": str(folder),
        "config": result.config.values,
        "engine": result.engine,
        "provenance": run.recorded().get("provenance"),
        "step": result.step,
        "finished": result.finished,
        "score": None,
        "policies": policies_at(run),
        "metrics": {name: numbers[:, -1].tolist() for name, numbers in result.metrics.items()},
        "load": f"earl_jax.load({str(folder)!r})",
    }
    with contextlib.suppress(InputError):  # no evaluation yet
        values |= {"score": result.score(chosen)._asdict(), **part_scores(own)}
    emit(values, json, _text(result, values, own))


def _text(result: "Result", values: dict[str, Any], own: "list[Curves]") -> str:
    """Return the summary of `result` as lines, with the mean of every metric over the seeds of each `own` part."""
    from earl_jax.runs.provenance import made_by

    texts = result.summary(own[0].window)
    del texts["metrics"]
    if "score" in texts:
        texts["score"] = f"\n{11 * ' '}".join(_scores(own))
    texts |= {
        "made by": printable(f"earl-jax {made_by(values['provenance']) or 'of an unknown version'}"),
        "policies": f"of step {values['policies']:,}" if values["policies"] else "none",
        "in Python": values["load"],
        "metrics": f"means over {counted(len(result.seeds), 'seed')} at step {result.steps[-1]:,}"
        if len(result.steps)
        else "none",
    }
    if len(own) > 1 and len(result.steps):
        texts["metrics"] += f", a column for each of {'; '.join(part.label for part in own)}"
    lines = [f"{title + ':':<10} {text}" for title, text in texts.items()]
    width = max(map(len, map(printable, result.metrics)), default=0)
    for name in result.metrics:
        means = "  ".join(f"{part.metrics[name][:, -1].mean():.6g}" for part in own)
        lines.append(f"  {printable(name):<{width}}  {means}")
    return "\n".join(lines)


def _scores(parts: "list[Curves]") -> list[str]:
    """Return the score of each of the `parts` of a run, with its diverged seeds, and its label if there are several."""
    from earl_jax.metrics.continuing import diverged_text
    from earl_jax.report.runs import labelled

    return labelled(parts, [f"{part.score()}{diverged_text(part.diverged, part.seeds)}" for part in parts])


def evaluate(
    folder: Positional[Path],
    episodes: int = 100,
    seed: int = 0,
    starts: Literal["initial", "uniform", "wide"] = "initial",
    pairs: Literal["random", "balanced"] | None = None,
    engine: str | None = None,
    last: int | None = None,
    window: int | None = None,
    json: bool = False,
) -> None:
    """Evaluate the newest policies of a run on fresh greedy episodes, beside the score of the run.

    Args:
        folder: Run folder with policies.npz or a checkpoint.
        episodes: Number of episodes for the policy of each seed.
        seed: Random seed of the starts and goals.
        starts: Initial states of the episodes: those of the task, uniform over the workspace, or wide.
        pairs: How pairs of start and goal are drawn: at random, or balanced (every pair equally often). By default as
            in the run.
    """
    from earl_jax import training
    from earl_jax.metrics.scores import Window
    from earl_jax.report.runs import labelled, part_scores, parts

    chosen, run = Window(last, window), training.load(folder)
    scores, texts, own = {"score": None}, ["no evaluation yet"], parts(run, chosen)
    if len(run.steps):
        scores, texts = {"score": run.score(chosen)._asdict(), **part_scores(own)}, _scores(own)
    metrics = training.evaluate(folder, episodes, seed, engine, starts, pairs)
    lines = [f"the newest policies over {episodes} new episodes each:"]
    lanes = [[run.seeds.index(seed) for seed in part.config.seeds] for part in own]
    for name, values in metrics.items():
        lines += labelled(own, [f"{name} {_mean_text(values[of_part])}" for of_part in lanes])
    lines += [f"the run: {text}" for text in texts]
    emit({name: values.tolist() for name, values in metrics.items()} | scores, json, "\n".join(lines))


def _mean_text(values: "np.ndarray") -> str:
    return f"{values.mean():.3f}, per seed {', '.join(f'{value:.3f}' for value in values)}"


def plot(
    folders: Positional[tuple[Path, ...]],
    out: tuple[Path, ...] = (Path("curves.png"),),
    labels: Texts = (),
    metric: str | None = None,
    size: Literal["screen", "column", "page"] = "screen",
    smooth: int = 1,
    published: bool = False,
) -> None:
    """Plot the deployed and continuing curves of runs, one line per method, with 95 % bands, and print a caption.

    Args:
        folders: Run folders, or folders that contain them, such as a sweep. Each task gets panels of its own.
        out: Pictures to write: .png, .pdf or .svg. A line says so if one replaces a file.
        size: screen, or one column (85 mm) or a whole page (175 mm) of a paper.
        smooth: Number of evaluations in the trailing mean that is drawn. 1 draws each as it is, at most 2,000 a line.
        published: Draw a panel for each run, with every seed, and the paper's released seeds in grey behind them.
    """
    from earl_jax.report.plots import caption, plot_runs

    if not out:
        raise InputError("--out needs a picture to write")
    names = tuple(itertools.chain(*labels))
    with contextlib.ExitStack() as stack:
        for path in out:
            stack.enter_context(replacing(path))
        plot_runs(folders, out[0], names, metric, size, smooth, published, out[1:])
    print(*out, caption(smooth, published), sep="\n")


def table(
    folders: Positional[tuple[Path, ...]],
    last: int | None = None,
    window: int | None = None,
    labels: Texts = (),
    metric: str | None = None,
    out: tuple[Path, ...] = (),
    json: bool = False,
) -> None:
    """Print the paper's two tables for runs, with the published numbers if there are any.

    Args:
        folders: Run folders, or folders that contain them, such as a sweep.
        out: Files that also receive the table: .md, .tex or .csv. By default none.
    """
    from earl_jax.metrics.scores import Window
    from earl_jax.report.tables import TABLES, run_table, tabulate, terminal_width, write
    from earl_jax.runs.files import require_suffix

    for path in out:
        require_suffix(path, TABLES, "tables")
    rows = tabulate(folders, Window(last, window), metric, tuple(itertools.chain(*labels)))
    for path in out:
        with replacing(path):
            write(rows, path)
    emit({"rows": rows}, json, run_table(rows).text(terminal_width()))


def best(
    folders: Positional[tuple[Path, ...]],
    test: Literal["permutation", "welch"] = "permutation",
    top: int = 20,
    metric: str | None = None,
    last: int | None = None,
    window: int | None = None,
    json: bool = False,
) -> None:
    """Rank the runs of a sweep, the longest first, and test which of these differ from the best of their task.

    Args:
        folders: Folders of sweeps, or run folders; seeds of the same task, method and options are pooled.
        test: Test of the difference from the best run, adjusted by Holm. The permutation test needs more seeds.
        top: Number of runs of each task to print; --json prints all.
    """
    from earl_jax.metrics.scores import Window
    from earl_jax.report.best import best as best_runs, best_text
    from earl_jax.report.tables import terminal_width

    rows = best_runs(folders, test, Window(last, window), metric)
    emit({"rows": rows}, json, best_text(rows, test, top, terminal_width()))


def compare(
    folders: Positional[tuple[Path, ...]],
    against: Literal["runs", "published"] = "runs",
    metric: str | None = None,
    last: int | None = None,
    window: int | None = None,
    out: tuple[Path, ...] = (),
    json: bool = False,
) -> None:
    """Test the differences of deployed scores between runs of a task, or from the published scores.

    Args:
        folders: Run folders, or folders that contain them; seeds of the same task, method and options are pooled.
        against: Compare each pair of runs on a task, the paper's methods in its order and others by name, or each run
            with the paper's five seeds at equal steps.
        out: Files that also receive the comparison: .md, .tex, .csv, .png, .pdf or .svg. By default none.
    """
    from earl_jax.metrics.scores import Window
    from earl_jax.report.comparison import FILES, compare as compare_runs, table_text, write_comparison
    from earl_jax.report.tables import terminal_width
    from earl_jax.runs.files import require_suffix

    for path in out:
        require_suffix(path, FILES, "comparisons")
    rows = compare_runs(folders, against, metric, Window(last, window))
    emit({"rows": rows}, json, table_text(rows, terminal_width()))
    for path in out:
        with replacing(path):
            write_comparison(rows, path)


def report(
    folders: Positional[tuple[Path, ...]],
    out: Path = Path("report.html"),
    watch: bool = False,
    every: float = 30.0,
    videos: bool = False,
    last: int | None = None,
    window: int | None = None,
) -> None:
    """Make one self-contained HTML page of runs: curves, tables, every seed, maps, videos, configs and versions.

    Args:
        folders: Run folders, or folders that contain them, such as a sweep or a reproduction.
        out: Page to write, .html. An existing page is replaced.
        watch: Write the page again whenever a run changes, until Ctrl-C; a browser reloads it. For a sweep in progress.
        every: Seconds between checks for changes with --watch.
        videos: Add six seconds of the median seed's policy for each run with policies.npz. This takes some seconds per
            run and needs the extra render.
    """
    import jax

    jax.config.update("jax_platforms", "cpu")  # an accelerator is not needed, and may be busy with training
    from earl_jax.metrics.scores import Window
    from earl_jax.report.html.media import PolicyVideos
    from earl_jax.report.html.writing import watch_page, write_page

    policies, chosen = PolicyVideos(print) if videos else None, Window(last, window)
    if watch:
        watch_page(folders, out, every, print, policies=policies, window=chosen)
        return
    with replacing(out):
        page = write_page(folders, out, policies=policies, window=chosen)
    print(f"{page}: {page.stat().st_size / 1e6:.1f} MB")
