"""Tables 1 and 2 and their claims, for runs of the published length and for what the paper does not have."""

import math

import numpy as np
import pytest
from scipy import stats

from earl_jax import assets
from earl_jax.paper.claims import best, changes_order, claim_rows, claims_text, counted, word
from earl_jax.paper.reproduce import ARTEFACTS
from earl_jax.report.pooling import read_methods
from earl_jax.report.published import published_fault, published_score
from tests.paper.written_runs import PEG, numbers, rewards, write_runs
from tests.report.run_files import DOOR, MINITAUR, TABLETOP, constant, read_csv


def gap(first, second):
    return abs(first.mean() - second.mean())


def test_runs_are_tested_by_permutations_of_released_seeds_or_by_welch_and_holm(tmp_path):
    """Ten seeds of naive RL at 0.95 and VaPRL at 0.5 against released ones; the Minitaur's against -1041.10 (49.84)."""
    spread, options = np.tile([-0.03, 0.03], 5), rewards(steps=[1_250_000, 2_500_000])
    runs = [(TABLETOP, algo, constant(*(mean + spread)), options) for algo, mean in (("naive", 0.95), ("vaprl", 0.5))]
    runs.append((MINITAUR, "naive", constant(*(spread - 900)), rewards(steps=[1_500_000, 3_000_000])))
    csv_file, text_file, _ = ARTEFACTS["table1"].write(write_runs(tmp_path, runs), tmp_path / "out")
    rows = {(row["env"], row["algo"]): row for row in read_csv(csv_file) if row["p"]}
    naive, vaprl, pen = (rows[name] for name in ((TABLETOP, "naive"), (TABLETOP, "vaprl"), (MINITAUR, "naive")))
    released = assets.released_runs(TABLETOP, "naive")["deployed"][:, 123:249].mean(axis=1)
    exact = stats.permutation_test((0.95 + spread, released), gap, n_resamples=5000, alternative="greater")
    assert numbers(naive, "p", "tested_steps") == pytest.approx([exact.pvalue, 2_500_000])
    for row in (naive, vaprl):
        assert float(row["p_holm"]) == pytest.approx(2 * float(row["p"]))
    error, released_error = 0.03 * math.sqrt(10 / 9), 44.58 * math.sqrt(25 / 4)
    welch = stats.ttest_ind_from_stats(-900, error, 10, -1041.1, released_error, 5, equal_var=False)
    assert numbers(pen, "p", "p_holm") == pytest.approx([welch.pvalue] * 2)
    assert [row["verdict"] for row in (naive, vaprl, pen)] == ["above", "below", "above"]
    text = text_file.read_text()
    assert "/ 0.32 (0.17) / above |" in text
    assert "| tabletop_organization | vaprl | 2.50M | 0.500 | 0.944 | -0.444 [" in text


def test_table_2_compares_lifetime_rewards_at_equal_steps(tmp_path):
    """Nothing was released of the oracle's life, nor, counted once, of R3L's on the door."""
    lifetime = {(PEG, "oracle"): 0.5, (TABLETOP, "vaprl"): 0.0093, (DOOR, "r3l"): 0.9, (DOOR, "fbrl"): 0.9}
    steps = [1_250_000, 2_500_000]
    runs = [(*name, constant(*[0.0] * 5), rewards(reward, steps=steps)) for name, reward in lifetime.items()]
    csv_file, text_file, _ = ARTEFACTS["table2"].write(write_runs(tmp_path, runs), tmp_path / "out")
    verdicts = {(row["env"], row["algo"]): row["verdict"] for row in read_csv(csv_file) if row["mean"]}
    assert verdicts == dict(zip(lifetime, ("-", "cannot tell", "-", "above"), strict=True))
    assert "0.5000 (0.0000) / - / -" in text_file.read_text()


def test_our_runs_are_tested_by_the_same_claims(tmp_path):
    """FBRL makes progress on the peg. benchmarks/results/paper/claims.md has the claims about the cells."""
    late = np.tile(np.repeat([0.0, 1.0], 6), (5, 1)) * (1 - np.linspace(0.0, 0.04, 5)[:, None])
    groups = read_methods(write_runs(tmp_path, [(PEG, "fbrl", late, rewards(0.1, steps=range(10, 130, 10)))]))
    [row] = [row for row in claim_rows(1, groups) if row["steps"]]
    assert (row["env"], row["first"], row["second"], word(row)) == (PEG, "fbrl", None, "progress")
    assert row["difference"] == pytest.approx(0.98)
    assert row["p"] == pytest.approx(stats.ttest_rel(late[:, -5:].mean(axis=1), late[:, 0]).pvalue)
    assert "| - | - | - | not run |" in claims_text(1, groups)


def test_a_run_whose_beginning_and_end_overlap_has_no_test_of_progress(tmp_path):
    run = (PEG, "fbrl", np.tile([0.0] * 4 + [1.0] * 5, (5, 1)), rewards(0.1))
    [row] = [row for row in claim_rows(1, read_methods(write_runs(tmp_path, [run]))) if row["steps"]]
    assert (word(row), math.isnan(row["p"])) == ("not tested: the beginning and end overlap", True)


def test_claims_are_about_the_defaults_of_a_method_then_about_the_first_run(tmp_path):
    """The means of the oracle at a reward scale of 2, at the default 10 and at 3 differ."""
    variants = [(0.1, {"reward_scale": 2.0}), (0.6, {}), (0.2, {"reward_scale": 3.0})]
    runs = [(TABLETOP, "vaprl", constant(0.9), rewards(0.3))]
    runs += [(TABLETOP, "oracle", constant(score), rewards(score, **options)) for score, options in variants]
    groups = read_methods(write_runs(tmp_path, runs))
    assert [claim_rows(1, order)[0]["other_mean"] for order in (groups, [*groups[:2], groups[3]])] == [0.6, 0.1]
    naive = [(TABLETOP, "naive", *run[2:]) for run in runs[1:]]
    behind = [(TABLETOP, "fbrl", constant(0.5), rewards(0.5))]
    assert "naive RL is the best on 1 of 1" in counted(read_methods(write_runs(tmp_path / "naive", naive + behind)))


def test_a_claim_needs_two_methods_on_a_task_and_ties_are_no_change_of_order(tmp_path):
    runs = write_runs(tmp_path, [(DOOR, "fbrl", constant(0.5), rewards(0.1))])
    assert "In our runs no task has two methods to compare." in counted(read_methods(runs))
    tied = {"naive": (0.0, 0.1), "fbrl": (0.0, 0.2)}
    assert not changes_order(tied)
    assert not changes_order({"naive": (0.0, 0.1), "fbrl": (0.3, 0.2)})
    assert changes_order({"naive": (0.4, 0.1), "fbrl": (0.3, 0.2)})
    assert best(tied, 0) == {"naive", "fbrl"}
    equal = [(TABLETOP, algo, constant(0.5), rewards(0.1)) for algo in ("naive", "fbrl")]
    text = counted(read_methods(write_runs(tmp_path / "equal", equal)))
    assert "In our runs naive RL is the best on 0 of 1, the best methods" in text


def test_the_contradiction_of_text_and_table_is_a_known_fault():
    fault = published_fault(1, "minitaur_pen")
    scores = {algo: published_score(1, "minitaur_pen", algo).mean for algo in ("r3l", "oracle")}
    assert "had left the pen" in fault
    assert f"the table has {scores['r3l']} for r3l and {scores['oracle']} for the oracle" in fault
    assert float(scores["r3l"]) < float(scores["oracle"])


@pytest.mark.parametrize("number", [1, 2])
def test_another_kind_of_reward_is_not_compared_and_has_a_panel_of_its_own(tmp_path, number):
    runs = [(TABLETOP, algo, constant(0.5), rewards()) for algo in ("naive", "fbrl")]
    runs += [(TABLETOP, "naive", constant(-5.0), rewards(env_options={"reward_type": "dense"}))]
    report = ARTEFACTS[f"table{number}"].report(write_runs(tmp_path, runs))
    [dense] = [row for row in report.tables[""] if row["label"] == "naive (reward_type=dense)"]
    metric = {1: "deployed/return", 2: "continuing/reward"}[number]
    assert (dense["metric"], dense["published_mean"], dense["verdict"]) == (metric, "-", "-")
    panels = [[label.get_text() for label in axis.get_xticklabels()] for axis in report.figure.axes]
    assert len(panels) == 2
    assert ["Naive RL (reward_type=dense)"] in panels
