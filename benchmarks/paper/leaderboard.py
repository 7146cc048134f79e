"""The leaderboard, docs/leaderboard.md, from run folders and published scores: `python -m benchmarks.paper.leaderboard`.

Rows of ours are the cells of the paper's table, the clones and the runs that were added; variants of the cells are in
results/paper/pairs.md. Published rows are in assets/published, scored over the same window where seeds were released. The
rows are also written to assets/published/leaderboard.csv, from which `earl-jax report` shows them beside a user's runs.
`--add RUN` checks a run folder, copies its config.json and metrics.csv into results/leaderboard, and writes page and rows
again.
"""

import math
import re
import shutil
import sys
import textwrap
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated, Any

import tyro

from benchmarks.output import RESULTS, ROOT, pages_with, write_files
from earl_jax import assets
from earl_jax.envs import PAPER_TASKS, make
from earl_jax.errors import InputError
from earl_jax.metrics.comparison import CANNOT_TELL, error_interval
from earl_jax.metrics.crossings import CROSSING_WINDOW
from earl_jax.metrics.statistics import Estimate
from earl_jax.paper.artefact import methods_on
from earl_jax.report.comparison import pair_row, with_verdicts
from earl_jax.report.leaderboard import COLUMNS, OURS, commit_of, crossing_texts, ranked, run_row, score_text, texts
from earl_jax.report.pooling import pooling_key
from earl_jax.report.published import RECONSTRUCTED, SEEDS, published_score, released_curves, training_steps
from earl_jax.report.runs import Curves, by_method, by_values, options_text, read
from earl_jax.report.scores import LEVELS, interval_of, seed_scores
from earl_jax.report.tables import Row, csv_text, markdown_table, millions, number_text
from earl_jax.runs.folder import RunFolder
from earl_jax.runs.provenance import CHANGED, short_commit

FOLDERS = "paper/*/*", "cloning/*", "leaderboard/*/*"
PAPER = "EARL, 2022"
EMPTY: Row = dict.fromkeys(("env", *COLUMNS, "score"), "-")
"""A row that has nothing."""
ROWS = ROOT / "assets" / "published" / "leaderboard.csv"
SPARSE = tuple(env for env in PAPER_TASKS if make(env).sparse)
CORRECTED = "cfbrl", "sawyer_peg", "corrected"
"""The method and the task whose runs have scripted corrections, unless this option is 0."""
SCRIPTED = "scripted corrections of this task"
FEWEST_SEEDS, FEWEST_EPISODES, RAREST_EVALUATION = 5, 10, 10_000
WHOLE = ("method", "deployed [95 %]")
"""Columns of the page that keep what stands in brackets."""
PAGE = (*WHOLE, "seeds", "steps", "from", "wide [95 %]", "C(A) [95 %]", "to 0.5", "chosen")
"""Columns of the page, the score where a phone shows it; the rows that ship have more. Our rows are from a commit."""
TESTS = RESULTS / "leaderboard" / "tests.csv"
FILES = ("config.json", "metrics.csv")
COMMIT = re.compile(r"[0-9a-f]{7,40}")


def folders(root: Path = RESULTS) -> list[Path]:
    """Return the run folders of the leaderboard."""
    return sorted(file.parent for pattern in FOLDERS for file in root.glob(f"{pattern}/metrics.csv"))


def entries(root: Path = RESULTS) -> list[Curves]:
    """Return the runs of the leaderboard by task and method, without those whose method is in a file of their own.

    Folders with the same task, method and options would be one method with more seeds; they are kept apart here,
    because their commits can differ.
    """
    read_runs = map(read, folders(root))
    runs = by_method([curves for curves in read_runs if curves.comparable and not curves.config.imports])
    return [_named(curves, runs) for curves in runs]


def _named(curves: Curves, runs: list[Curves]) -> Curves:
    """Return `curves` named by its changed options in which its method's runs differ, and `SCRIPTED` where that is so."""
    cell, own = (curves.algo, curves.env), curves.options
    peers = [other.options for other in runs if (other.algo, other.env) == cell]
    named = {name: own[name] for name in own if any(other.get(name, "the default") != own[name] for other in peers)}
    marks = [SCRIPTED] if cell == CORRECTED[:2] and own.get(CORRECTED[2]) != 0 else []
    text = "; ".join([*marks, options_text(named)] if named else marks)
    return curves._replace(label=f"{curves.algo} ({text})" if text else curves.algo)


def rows_of(runs: list[Curves]) -> list[Row]:
    """Return the rows of our runs and the published ones, by task and deployed mean."""
    by_task = ranked([*map(run_row, runs), *published_rows()])
    return [row for env in PAPER_TASKS for row in by_task.get(env, [])]


def published_rows() -> list[Row]:
    """Return the rows of the paper and those of newer papers, without those of a task that is our reconstruction."""
    cells = [(env, algo) for env in PAPER_TASKS if env not in RECONSTRUCTED for algo in methods_on(env)]
    rows = [_paper_row(env, algo) for env, algo in cells if (score := published_score(1, env, algo)) and score.sample]
    return rows + [_newer_row(row) for row in assets.published("newer")]


def _paper_row(env: str, algo: str) -> Row:
    score, rewards = published_score(1, env, algo), published_score(2, env, algo)
    assert score is not None
    length, crossings = training_steps(env), {}
    deployed = Estimate(score.value, *score.interval)
    if released := released_curves(env, algo):
        released = released.until(length)
        length, crossings = released.length, crossing_texts(released)
        deployed = interval_of(released, seed_scores(released))
    return EMPTY | {
        "env": env,
        "method": algo,
        "source": PAPER,
        "seeds": SEEDS,
        "steps": length,
        "deployed": score_text(env, *deployed),
        "continuing": rewards.text if rewards else "-",
        **crossings,
        "score": round(float(deployed.value), 6),
    }


def _newer_row(row: dict[str, str]) -> Row:
    """Return a row of newer.csv, whose standard errors divide the population's deviation by sqrt(n)."""
    mean, seeds = float(row["mean"]), int(row["seeds"])
    error = float(row["stderr"] or "nan") * math.sqrt(seeds / (seeds - 1))
    low, high = error_interval(mean, error, seeds, make(row["env"]).sparse)
    return EMPTY | {
        "env": row["env"],
        "method": row["method"],
        "source": f"{row['source']}, {row['year']}",
        "seeds": seeds,
        "steps": int(row["steps"]),
        "deployed": score_text(row["env"], mean, float(low), float(high)),
        **{f"to_{level}": millions(float(row[f"steps_to_{level}"] or "nan")) for level in LEVELS},
        "score": round(mean, 6),
    }


def scores_text(rows: list[Row]) -> str:
    """Return a table for each task that opens at a click, with intervals of the deployed score alone.

    Columns that are empty are left out, as is the number of seeds where it is the same in all rows and so above the table.
    """
    parts = []
    for env, of_task in ranked(rows).items():
        shown = [_shown(cells) for cells in (list(COLUMNS.values()), *map(texts, of_task))]
        above, columns = "", []
        for name, *cells in zip(*shown, strict=True):
            if name == "seeds" and len(set(cells)) == 1:
                above = f" of {cells[0]} seeds"
            elif set(cells) != {"-"}:
                columns.append([name, *cells])
        header, *lines = zip(*columns, strict=True)
        summary = f"<details markdown><summary>{len(lines)} rows{above}</summary>"
        parts.append(f"### {env}\n\n{summary}\n\n{markdown_table(header, lines)}\n\n</details>")
    return "\n\n".join(parts)


def _shown(cells: Sequence[str]) -> list[str]:
    """Return the cells of the columns of the page, which gives the publications in full below its tables."""
    named = dict(zip(COLUMNS.values(), cells, strict=True))
    named["from"] = named["commit"] if named["from"] == OURS else re.sub(" et al[.]|, .*", "", named["from"])
    return [named[name] if name in WHOLE else named[name].partition(" [")[0] for name in PAGE]


def tests(runs: list[Curves]) -> list[dict[str, Any]]:
    """Return the tests of two questions a task, each a family of Holm's adjustment.

    Which methods differ from naive RL, by the longest run of each (of equal ones, that with the fewest options), and which
    further runs of a method from its longest.
    """
    rows = []
    for first, second in _pairs(runs):
        question = "methods" if first.algo != second.algo else f"runs of {first.algo}"
        if min(first.seeds, second.seeds) >= FEWEST_SEEDS and (row := pair_row(first, second)):
            rows.append({"question": question, **row})
    return with_verdicts([row for row in rows if row["steps"] >= CROSSING_WINDOW], family=("env", "question"))


def _pairs(runs: list[Curves]) -> Iterator[tuple[Curves, Curves]]:
    """Yield the pairs of runs that the questions compare."""
    longest: dict[tuple[str, str], Curves] = {}
    for curves in sorted(runs, key=lambda curves: (-curves.length, len(curves.options))):
        longest.setdefault((curves.env, curves.algo), curves)
    for curves in runs:
        own, naive = longest[curves.env, curves.algo], longest.get((curves.env, "naive"))
        if curves is not own:
            yield curves, own
        elif naive and curves is not naive:
            yield curves, naive


def tests_text(rows: list[dict[str, Any]]) -> str:
    """Return a table of the `tests` that tell runs apart, and what the others could detect."""
    clear = [row for row in rows if row["verdict"] != CANNOT_TELL]
    found = [
        row["detectable"]
        for row in rows
        if row["env"] in SPARSE and row["verdict"] == CANNOT_TELL and row["detectable"] > 0
    ]
    text = f"{len(clear)} of {len(rows)} pairs differ. For the others the seeds cannot tell"
    text += f" (detectable on sparse tasks: {min(found):.2f} to {max(found):.2f})." if found else "."
    header = ("task", "run", "against", "at step", "difference [95 %]", "adjusted p")
    return f"{textwrap.fill(text, 100)}\n\n{markdown_table(header, [_test_line(row) for row in clear])}"


def _test_line(row: dict[str, Any]) -> list[str]:
    difference = score_text(row["env"], row["difference"], row["low"], row["high"])
    return [row["env"], row["first"], row["second"], millions(row["steps"]), difference, number_text(row["p_holm"])]


def add(run: Path, root: Path = RESULTS) -> Path:
    """Copy the config and metrics of `run` into results/leaderboard and return their folder.

    Raises:
        ValueError: the run breaks a rule of docs/leaderboard.md; the message names it.
    """
    curves = read(run)
    config = curves.config
    _require(config.env in PAPER_TASKS, f"{config.env} is not one of the tasks {', '.join(PAPER_TASKS)}")
    _require(curves.comparable, "the task has options, another kind of reward or another setting than the paper's")
    _require("demo_file" not in config.env_options, "it was trained with other demonstrations than those that ship")
    _require(not config.algo_class, f"{config.algo_class} is not registered, so others cannot repeat the run")
    _require(not config.imports, "it was trained with a file of its own; a package can bring the method")
    _require(len(by_values(curves)) == 1, "its seeds have different hyper-parameters")
    _require(curves.seeds >= FEWEST_SEEDS, f"it has {curves.seeds} seeds, fewer than {FEWEST_SEEDS}")
    _require(config.eval_episodes >= FEWEST_EPISODES, f"evaluations have fewer than {FEWEST_EPISODES} episodes")
    _require(config.eval_every <= RAREST_EVALUATION, f"evaluations are more than {RAREST_EVALUATION:,} steps apart")
    _require(curves.length == config.steps, f"it has {curves.length} of {config.steps} steps")
    commit = commit_of(curves)
    releases = re.findall(r"^## (\S+)", (ROOT / "CHANGELOG.md").read_text(), flags=re.MULTILINE)
    _require(bool(commit), "its config.json has neither a commit nor a release")
    _require(not commit.endswith(CHANGED), f"{short_commit(commit)} lacks changes that it was trained with")
    _require(bool(COMMIT.fullmatch(commit)) or commit in releases, f"{commit} is neither a commit nor in CHANGELOG.md")
    known = {pooling_key(RunFolder.open(folder).config): folder for folder in folders(root)}
    other = known.get(pooling_key(config))
    _require(other is None, f"{other} has the same task, method and options")
    target = root / "leaderboard" / config.env / f"{config.algo}-{RunFolder.open(run).id[:8]}"
    _require(not target.exists(), f"{target} exists")
    target.mkdir(parents=True)
    for name in FILES:
        shutil.copyfile(run / name, target / name)
    return target


def _require(condition: bool, rule: str) -> None:
    if not condition:
        raise InputError(f"this run cannot be added: {rule}")


def files() -> dict[Path, str]:
    """Return the page and the rows that ship, from the runs and the published scores."""
    runs = entries()
    rows, tested = rows_of(runs), tests(runs)
    tables = {"scores": scores_text(rows), "tests": tests_text(tested)}
    return {**pages_with(tables), ROWS: csv_text(rows), TESTS: csv_text(tested)}


def main(run: Annotated[Path | None, tyro.conf.arg(name="add", metavar="RUN")] = None) -> None:
    """Write the page, with the run folder to add if one is given."""
    if run:
        try:
            print(add(run))
        except InputError as error:
            sys.exit(f"{error}")
    write_files(files())


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
