"""The runs at the paper's settings as tables: `python -m benchmarks.paper_cells` writes cells.csv and cells.md beside them.

`cells`: each run with the mean over seeds of the final and of the last ten evaluations. A run of the published length is
compared with the published final score by Welch's test from means, standard errors and numbers of seeds. `PAIRS`: runs that
differ in one option, at equal steps, by a permutation test of the seeds' means over ten evaluations.
"""

from pathlib import Path
from typing import Any

import numpy as np
from scipy import stats

from earl_jax.report.published import published_score, published_steps
from earl_jax.report.runs import Curves, read
from earl_jax.report.tables import WINDOW, markdown_table, write

ROOT = Path(__file__).parent / "results" / "paper"
PUBLISHED_SEEDS = 5
TABLETOP, PEG = "tabletop_organization", "sawyer_peg"
PAIRS = [
    (f"{TABLETOP}/fbrl", f"{TABLETOP}/fbrl/tf32"),
    (f"{TABLETOP}/naive", f"{TABLETOP}/naive/episode_200"),
    (f"{TABLETOP}/naive", f"{TABLETOP}/naive/episode_400"),
    (f"{TABLETOP}/naive", f"{TABLETOP}/naive/random_10000"),
    (f"{PEG}/oracle", f"{PEG}/oracle/reward_scale_1"),
]
PERMUTATIONS = 100_000


def cell(name: str, curves: Curves) -> dict[str, Any]:
    """Return the row of a run: scores, the largest critic loss, and the comparison at the published length."""
    scores = curves.metrics[curves.deployed_metric]
    final, recent = scores[:, -1], scores[:, -WINDOW:].mean(axis=1)
    half = stats.t.ppf(0.975, len(recent) - 1) * stats.sem(recent)
    row = {
        "run": name,
        "metric": curves.deployed_metric,
        "seeds": curves.seeds,
        "steps": int(curves.steps[-1]),
        "of": curves.config.steps,
        "final": final.mean(),
        "final_stderr": stats.sem(final),
        "last10": recent.mean(),
        "last10_stderr": stats.sem(recent),
        "low": recent.mean() - half,
        "high": recent.mean() + half,
        "reward": curves.metrics["continuing/reward"][:, -1].mean(),
        "largest_critic_loss": curves.metrics["critic_loss"].max(),
    }
    return {**row, **_against_published(name, curves, final)}


def _against_published(name: str, curves: Curves, final: np.ndarray) -> dict[str, Any]:
    """Return the published score of the cell, and for its own run of that length the difference, interval and p."""
    config, steps = curves.config, published_steps(curves.config.env)
    score = published_score("table1", config.env, config.algo)
    texts = {"published": score.text if score else None}
    is_variant, length = name.count("/") > 1, steps and steps[0]
    if score is None or is_variant or not length or curves.steps[-1] < length:
        return {**texts, "difference": None, "difference_low": None, "difference_high": None, "p": None}
    difference = final.mean() - float(score.mean)
    errors = np.array([stats.sem(final), float(score.stderr)]) ** 2
    freedom = errors.sum() ** 2 / (errors**2 / (np.array([len(final), PUBLISHED_SEEDS]) - 1)).sum()
    spread = np.sqrt(errors.sum())
    half = stats.t.ppf(0.975, freedom) * spread
    p = 2 * stats.t.sf(abs(difference) / spread, freedom)
    return {
        **texts,
        "difference": difference,
        "difference_low": difference - half,
        "difference_high": difference + half,
        "p": p,
    }


def pair(first: str, second: str, runs: dict[str, Curves]) -> dict[str, Any]:
    """Return the comparison of two runs at the last step that both have."""
    step = min(runs[first].steps[-1], runs[second].steps[-1])
    scores = [_recent_at(runs[name], step) for name in (first, second)]
    test = stats.permutation_test(
        scores, lambda a, b: b.mean() - a.mean(), n_resamples=PERMUTATIONS, rng=np.random.default_rng(0)
    )
    return {
        "first": first,
        "second": second,
        "steps": int(step),
        **{f"{name}_mean": values.mean() for name, values in zip(("first", "second"), scores, strict=True)},
        "difference": test.statistic,
        "p": test.pvalue,
    }


def _recent_at(curves: Curves, step: int) -> np.ndarray:
    """Return each seed's mean over the ten evaluations up to `step`."""
    end = int(np.searchsorted(curves.steps, step)) + 1
    return curves.metrics[curves.deployed_metric][:, end - WINDOW : end].mean(axis=1)


def _text(value: Any) -> str:
    if value is None:
        return "-"
    return f"{value:,}" if isinstance(value, int) else f"{value:.3g}" if isinstance(value, float) else str(value)


def _markdown(rows: list[dict[str, Any]]) -> str:
    plain = [{name: value.item() if hasattr(value, "item") else value for name, value in row.items()} for row in rows]
    return markdown_table(list(rows[0]), [list(map(_text, row.values())) for row in plain])


def main() -> None:
    """Write cells.csv, pairs.csv and cells.md."""
    paths = sorted(path.parent for path in ROOT.rglob("metrics.csv"))
    runs = {str(path.relative_to(ROOT)): read(path) for path in paths}
    cells = [cell(name, curves) for name, curves in runs.items()]
    pairs = [pair(first, second, runs) for first, second in PAIRS]
    write(cells, ROOT / "cells.csv")
    write(pairs, ROOT / "pairs.csv")
    (ROOT / "cells.md").write_text(f"{_markdown(cells)}\n\n{_markdown(pairs)}\n")
    print((ROOT / "cells.md").read_text())


if __name__ == "__main__":
    main()
