"""The tests between our runs: which runs they pool or join, their families and verdicts, and successes from uniform starts."""

import json
import shutil

import jax
import numpy as np
import pytest

from benchmarks.output import read_csv
from benchmarks.paper import cells, differences, join, pairs, uniform_starts
from earl_jax.errors import InputError
from earl_jax.metrics.comparison import holm, permutation
from earl_jax.report.tables import csv_text
from earl_jax.runs.contents import CONFIG, METRICS
from earl_jax.runs.folder import RunFolder
from tests.report.run_files import DOOR, constant, write_run

FORMER = {"nearest_fallback": False, "unmet_goals": False}
ALL_KEPT = f"{DOOR}/vaprl/replay_capacity_None"
VARIANT = f"{DOOR}/vaprl/{cells.FORMER_VAPRL}"
RNG = np.random.default_rng(0)
TWO = {"initial": np.full(5, 0.9), "within_2.5": np.linspace(0.1, 0.3, 5)}
ONE = {"initial": np.full(5, 0.9), "within_2.5": np.linspace(0.7, 0.9, 5)}


@pytest.fixture
def no_starts(tmp_path):
    """A file of successes from uniform starts without any."""
    file = tmp_path / "seeds.csv"
    file.write_text("run,seed," + ",".join(uniform_starts.KINDS) + "\n")
    return file


@pytest.fixture
def compared(tmp_path, no_starts, monkeypatch):
    """The rows of some pairs of runs below tmp_path, which are one difference."""

    def rows(*tested):
        monkeypatch.setattr(differences, "DIFFERENCES", (pairs.Difference("4", "layer norm", tested),))
        return differences.comparisons(tmp_path, no_starts)

    return rows


def lines(rows, own_cells=()):
    """Return the cells of the table's lines, of which the first is `#`."""
    text = differences.table(rows, list(own_cells)).splitlines()[2:]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in text]


def test_without_runs_every_difference_is_not_run(tmp_path, no_starts):
    rows = differences.comparisons(tmp_path, no_starts)
    assert rows == []
    table = lines(rows)
    assert {line[-1] for line in table} == {"not run"}
    assert ", ".join(line[0] for line in table) == ", ".join(map(str, range(1, 36))), "a line may have several numbers"


def test_a_difference_is_settled_by_the_test_of_its_runs(tmp_path, no_starts):
    scores, others = np.linspace(0.0, 0.2, 6), np.linspace(0.6, 1.0, 6)
    write_run(tmp_path / ALL_KEPT, DOOR, "vaprl", constant(*others))
    write_run(tmp_path / VARIANT, DOOR, "vaprl", constant(*scores), **FORMER)
    [row] = differences.comparisons(tmp_path, no_starts)
    expected = permutation(scores, others)
    assert (row["number"], row["difference"], row["p"]) == ("5, 6", pytest.approx(-0.7), expected.p)
    [line] = [line for line in lines([row]) if line[-1] != "not run"]
    assert line[0] == "5, 6"
    assert line[-1] == "the first is below"
    assert line[-2] == "0.0022"


def test_a_family_has_the_tests_of_a_difference_on_a_task(tmp_path, no_starts):
    own = {"replay_capacity_None": {}, cells.FORMER_VAPRL: FORMER}
    for env, variants in ((DOOR, {**own, "no_unmet_goals": {"unmet_goals": False}}), (differences.TABLETOP, own)):
        for name, options in variants.items():
            write_run(tmp_path / f"{env}/vaprl/{name}", env, "vaprl", constant(*RNG.random(5)), **options)
    *door, tabletop = differences.comparisons(tmp_path, no_starts)
    assert [row["p_holm"] for row in door] == pytest.approx(holm([row["p"] for row in door]))
    assert len(door) == 2
    assert tabletop["p_holm"] == tabletop["p"]


@pytest.mark.parametrize(
    ("own", "others", "settled"),
    [
        ((0.1, 0.2, 0.3), (0.6, 0.7, 0.8), "the seeds do not overlap, but so few can have no smaller p"),
        ((0, 0), (0, 0, 0), "all seeds are equal"),
    ],
)
def test_what_the_seeds_cannot_tell_is_said(tmp_path, no_starts, own, others, settled):
    write_run(tmp_path / ALL_KEPT, DOOR, "vaprl", constant(*others))
    write_run(tmp_path / VARIANT, DOOR, "vaprl", constant(*own), **FORMER)
    [line] = [line for line in lines(differences.comparisons(tmp_path, no_starts)) if line[-1] != "not run"]
    assert line[-1] == f"cannot tell: {settled}"
    assert (line[7] == "0.000 [-, -]") == (own == (0, 0))


def test_seeds_of_a_side_are_pooled_at_equal_steps(tmp_path, compared):
    first, more, norm = (f"{pairs.PEG}/oracle{name}" for name in ("", "/seeds_5_to_14", "/layer_norm"))
    write_run(tmp_path / first, pairs.PEG, "oracle", RNG.random((5, 6)))
    write_run(tmp_path / more, pairs.PEG, "oracle", RNG.random((10, 3)), seeds=range(5, 15))
    write_run(tmp_path / norm, pairs.PEG, "oracle", RNG.random((4, 4)), layer_norm=True)
    own, pooled = compared(pairs.Pair((first,), (norm,)), pairs.Pair((first, more), (norm,)))
    assert (own["seeds"], own["steps"]) == (5, 40)
    assert (pooled["seeds"], pooled["other_seeds"], pooled["steps"]) == (15, 4, 30)
    assert [own["p_holm"], pooled["p_holm"]] == pytest.approx(holm([own["p"], pooled["p"]]))


def test_the_test_with_the_released_runs_is_no_part_of_the_family_of_ours(tmp_path, compared):
    own, other = (f"{DOOR}/naive",), (f"{DOOR}/naive/other",)
    for [name], options in ((own, {}), (other, {"discount": 0.9})):
        write_run(tmp_path / name, DOOR, "naive", constant(*RNG.random(5)), steps=[10_000, 20_000], **options)
    ours, released = compared(pairs.Pair(own, other), pairs.Pair(other, pairs.PUBLISHED))
    assert (ours["second"], released["first"], released["second"]) == ("naive/other", "naive/other", "published")
    assert (released["steps"], released["other_seeds"]) == (20_000, 5)
    assert [ours["p_holm"], released["p_holm"]] == [ours["p"], released["p"]]


def test_one_controller_is_tested_from_uniform_starts():
    success, loss, share = differences.starts_rows({differences.TWO: TWO, differences.ONE: ONE})
    assert success["difference"] == pytest.approx(-0.6)
    assert loss["difference"] == pytest.approx(0.6)
    assert share["difference"] == pytest.approx(0.6 / 0.9)
    assert success["p"] == loss["p"] == share["p"] == pytest.approx(2 / 252)
    assert loss["mean_low"] + loss["mean_high"] == pytest.approx(2 * loss["mean"]), "a loss is no rate"
    assert differences.starts_rows({differences.TWO: TWO}) == []


def test_policies_of_the_published_length_are_evaluated_from_each_kind_of_start(whole_run, monkeypatch):
    """R3L's five policies succeed from nearly all starts, those of a run that was cut are left out, known rows stay."""
    monkeypatch.setattr(uniform_starts, "KINDS", {"initial": None, "within_2.5": 2.5})
    root = whole_run.parent
    cut = shutil.copytree(whole_run, root / "cut") / "metrics.csv"
    cut.write_text("".join(cut.read_text().splitlines(keepends=True)[:101]))
    known = [{"run": "oracle", "seed": "0", "commit": "0", "initial": "0.5", "within_2.5": "0.5"}]
    rows = uniform_starts.evaluate(root, episodes=4, known=known)
    assert rows[0] == known[0]
    assert [(row["run"], row["seed"]) for row in rows[1:]] == [("r3l", seed) for seed in range(5)]
    for kind in uniform_starts.KINDS:
        assert np.mean([row[kind] for row in rows[1:]]) > 0.7
    again = [{**row, "initial": "0.5"} for row in rows]
    assert uniform_starts.evaluate(root, known=again) == again


def test_uniform_starts_fill_their_square(env):
    obs = np.asarray(jax.vmap(uniform_starts.within(env, 2.5))(jax.random.split(jax.random.key(0), 500)).obs[:, :4])
    assert np.abs(obs).max() <= 2.5
    assert (np.abs(obs).max(axis=0) > 2.4).all()


def test_runs_of_other_seeds_are_joined_up_to_the_step_that_all_have(tmp_path):
    whole = cells.RUNS / "franka_kitchen/fbrl"
    config, rows = json.loads((whole / CONFIG).read_text()), read_csv(whole / METRICS)
    for folder, seeds, end in (("a", [8, 9], 4_800_000), ("b", [5, 6, 7], 200_000)):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / CONFIG).write_text(json.dumps(config | {"seeds": seeds, "id": folder}))
        own = [row for row in rows if int(row["seed"]) in seeds and int(row["step"]) <= end]
        (tmp_path / folder / METRICS).write_text(csv_text(own))
    join.main(tmp_path / "joined", (tmp_path / "a", tmp_path / "b"))
    common = (whole / METRICS).read_text().splitlines(keepends=True)[: 1 + 4 * 5]
    assert (tmp_path / "joined" / METRICS).read_text() == "".join(common)
    assert RunFolder.open(tmp_path / "joined").config.seeds == (5, 6, 7, 8, 9)
    (tmp_path / "b" / CONFIG).write_text(json.dumps(config | {"seeds": [5, 6, 7], "eval_every": 10}))
    with pytest.raises(InputError, match="differ in eval_every"):
        join.joined([tmp_path / "a", tmp_path / "b"])
    with pytest.raises(InputError, match="a seed is in two of the runs"):
        join.joined([tmp_path / "a", tmp_path / "a"])
