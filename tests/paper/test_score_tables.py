"""Tables 1 and 2 and their claims, for runs of the published length and for what the paper does not have."""

import math

import numpy as np
import pytest
from scipy import stats

from earl_jax.paper.claims import best, changes_order, table2_claims
from earl_jax.paper.reproduce import ARTEFACTS
from earl_jax.report.paper_rows import paper_rows
from earl_jax.report.published import published_fault, published_score
from earl_jax.report.runs import read_methods
from tests.paper.written_runs import PEG, RUNS, numbers, rewards, write_runs
from tests.report.run_files import DOOR, TABLETOP, constant, read_csv


def test_runs_of_the_published_length_are_tested_by_welch_and_holm(tmp_path):
    """Ten seeds of naive at 0.95 (0.01) against 0.32 (0.19), and of VaPRL at 0.5 (0.01) against 0.98 (0.022)."""
    spread, options = np.tile([-0.03, 0.03], 5), rewards(steps=[1_250_000, 2_500_000])
    runs = [(TABLETOP, algo, constant(*(mean + spread)), options) for algo, mean in (("naive", 0.95), ("vaprl", 0.5))]
    csv_file, text_file, _ = ARTEFACTS["table1"].write(write_runs(tmp_path, runs), tmp_path / "out")
    rows = {row["algo"]: row for row in read_csv(csv_file) if row["p"]}
    published = 0.32, 0.17 * math.sqrt(25 / 4), 5
    naive = stats.ttest_ind_from_stats(0.95, 0.03 * math.sqrt(10 / 9), 10, *published, equal_var=False)
    assert numbers(rows["naive"], "p", "p_holm") == pytest.approx([naive.pvalue] * 2)
    assert float(rows["vaprl"]["p_holm"]) == pytest.approx(2 * float(rows["vaprl"]["p"]))
    assert [rows[algo]["verdict"] for algo in ("naive", "vaprl")] == ["above", "below"]
    text = text_file.read_text()
    assert "/ 0.32 (0.17) / above |" in text
    assert "| tabletop_organization | vaprl | -0.480 [" in text


def test_table_2_compares_lifetime_rewards_with_bounds_and_missing_scores(tmp_path):
    """Two seeds with the same reward have no spread; the published 0.009 (0.000) and 0.329 (0.080) do."""
    lifetime = {(PEG, "naive"): 0.0015, (PEG, "oracle"): 0.5, (TABLETOP, "vaprl"): 0.0094, (DOOR, "fbrl"): 0.9}
    steps = [3_000_000, 6_000_000]
    runs = [(*name, constant(0.0, 0.0), rewards(reward, steps=steps)) for name, reward in lifetime.items()]
    csv_file, text_file, _ = ARTEFACTS["table2"].write(write_runs(tmp_path, runs), tmp_path / "out")
    verdicts = {(row["env"], row["algo"]): row["verdict"] for row in read_csv(csv_file) if row["mean"]}
    assert verdicts == dict(zip(lifetime, ("-", "-", "cannot tell", "above"), strict=True))
    text = text_file.read_text()
    assert "0.0015 (0.0000) / <0.001 / -" in text
    assert "0.5000 (0.0000) / - / -" in text


def test_a_claim_needs_two_methods_on_a_task_and_ties_are_no_change_of_order(tmp_path):
    runs = write_runs(tmp_path, RUNS["table2"][-1:])
    assert "In our runs no task has two methods to compare." in table2_claims(read_methods(runs))
    tied = {"naive": (0.0, 0.1), "fbrl": (0.0, 0.2)}
    assert not changes_order(tied)
    assert not changes_order({"naive": (0.0, 0.1), "fbrl": (0.3, 0.2)})
    assert changes_order({"naive": (0.4, 0.1), "fbrl": (0.3, 0.2)})
    assert best(tied, 0) == {"naive", "fbrl"}


def test_the_contradiction_of_text_and_table_is_a_known_fault():
    fault = published_fault("table1", "minitaur_pen")
    scores = {algo: published_score("table1", "minitaur_pen", algo).mean for algo in ("r3l", "oracle")}
    assert "had left the pen" in fault
    assert f"the table has {scores['r3l']} for r3l and {scores['oracle']} for the oracle" in fault
    assert float(scores["r3l"]) < float(scores["oracle"])


def test_another_kind_of_reward_is_not_compared(tmp_path):
    runs = [(TABLETOP, "naive", constant(-5.0), rewards(env_options={"reward_type": "dense"}))]
    row = next(row for row in paper_rows(1, read_methods(write_runs(tmp_path, runs))) if row["mean"] is not None)
    assert (row["metric"], row["published_mean"], row["verdict"]) == ("deployed/return", "-", "-")
