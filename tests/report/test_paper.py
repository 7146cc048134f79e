"""The paper's tables and curves on runs written by hand, against numbers computed by hand."""

import csv
import math

import numpy as np
import pytest
from matplotlib.colors import to_rgb
from matplotlib.image import imread

from earl_jax.algos import make_algo
from earl_jax.envs import make
from earl_jax.metrics.statistics import Estimate
from earl_jax.paper import tables as paper_tables
from earl_jax.paper import verdicts
from earl_jax.paper.curves import write_curves
from earl_jax.report.runs import cells
from earl_jax.report.style import COLOURS, TITLES, colours, ordered
from earl_jax.runs.config import RunConfig
from earl_jax.runs.folder import RunFolder

TABLETOP, DOOR, KITCHEN = "tabletop_organization", "sawyer_door", "franka_kitchen"


def write_run(path, env, algo, deployed, lifetime=0.0, steps=(10, 20), env_options=None, **options):
    """Write a run whose seeds score `deployed [N, E]`, or N numbers throughout, and earn `lifetime` a step."""
    scores = np.asarray(deployed, float)
    scores = scores if scores.ndim == 2 else np.repeat(scores[:, None], len(steps), axis=1)
    world, method = make(env, **(env_options or {})), make_algo(algo, **options)
    folder = RunFolder.create(path, RunConfig.of(world, method, range(len(scores)), steps[-1], steps[0], 2, 10))
    for number, step in enumerate(steps):
        values = dict.fromkeys(("deployed/success", "deployed/return"), scores[:, number])
        folder.append(folder.config.rows(step, {**values, "continuing/reward": np.full(len(scores), lifetime)}))
    return path


def table(path):
    with path.open() as handle:
        return list(csv.DictReader(handle))


def drawn(path, colour):
    """Return how many pixels of a picture have `colour`."""
    return int((np.abs(imread(path)[..., :3] - to_rgb(colour)).max(axis=-1) < 0.01).sum())


def test_a_published_interval_is_1_96_errors_and_half_a_printed_digit():
    assert verdicts.interval("0.32", "0.17") == pytest.approx((0.32 - 0.3332 - 0.0148, 0.32 + 0.3332 + 0.0148))
    assert verdicts.interval("-2705.21", "167.10") == pytest.approx((-2705.21 - 327.5308, -2705.21 + 327.5308))
    assert verdicts.interval("1.00", "0.00") == pytest.approx((0.9852, 1.0148))
    assert verdicts.interval("<0.001", "-") == (0, 0.001)
    assert verdicts.interval("-", "-") is None


def test_a_verdict_is_within_at_the_ends_and_nothing_without_numbers():
    assert [verdicts.verdict(value, (0.1, 0.2)) for value in (0.0999, 0.1, 0.2, 0.2001)] == [
        "below", "within", "within", "above",
    ]  # fmt: skip
    assert verdicts.verdict(0.1, None) == verdicts.verdict(None, (0, 1)) == verdicts.verdict(math.nan, (0, 1)) == "-"


def test_what_is_told_needs_the_whole_interval_on_one_side():
    assert verdicts.told(Estimate(4, 3, 5), "more", "less", "nothing") == "more"
    assert verdicts.told(Estimate(-1, -2, -0.1), "more", "less", "nothing") == "less"
    assert verdicts.told(Estimate(0, -1, 1), "more", "less", "nothing") == "nothing"
    assert verdicts.told(Estimate(1, math.nan, math.nan), "more", "less", "nothing") == "nothing"


def test_table_1_judges_every_cell_by_its_last_evaluation(tmp_path):
    folders = [
        write_run(tmp_path / "a", KITCHEN, "naive", [-2500.0, -2900.0]),
        write_run(tmp_path / "b", TABLETOP, "naive", [[0.0, 0.7], [0.4, 0.9]]),
        write_run(tmp_path / "c", TABLETOP, "fbrl", [0.7, 0.8]),
        write_run(tmp_path / "d", TABLETOP, "fbrl", [0.5], reward_scale=1.0),
        write_run(tmp_path / "e", DOOR, "oracle", [0.9, 1.0]),
    ]
    csv_file, text_file, picture = paper_tables.write_table(1, folders, tmp_path / "out")
    rows = {(row["env"], row["label"]): row for row in table(csv_file)}
    naive = rows[TABLETOP, "naive"]
    numbers = {name: float(naive[name]) for name in ("mean", "stderr", "low", "high", "last10", "last10_stderr")}
    assert numbers == pytest.approx(
        {
            "mean": 0.8,
            "stderr": 0.1 / math.sqrt(2),
            "low": 0.7,
            "high": 0.9,
            "last10": 0.5,
            "last10_stderr": 0.15 / math.sqrt(2),
        }
    )
    assert (naive["verdict"], naive["seeds"], naive["steps"], naive["published_last10"]) == ("above", "2", "20", "0.33")
    assert float(naive["published_low"]) == pytest.approx(-0.028)
    assert rows[TABLETOP, "fbrl"]["verdict"] == "below"
    assert rows[TABLETOP, "fbrl (reward_scale=1.0)"]["mean"] == "0.5"
    assert rows[DOOR, "oracle"]["verdict"] == "below"
    assert rows[KITCHEN, "naive"]["verdict"] == "within"
    assert rows[KITCHEN, "r3l"]["mean"] == ""
    assert [row["env"] for row in table(csv_file)] == sorted((env for env, _ in rows), key=list(TITLES).index)
    text = text_file.read_text()
    assert "| naive | 0.800 (0.071) / 0.32 (0.17) / above at 0.0008 % of the steps | - / 0.00 (0.00) / - |" in text
    assert "| -2700.00 (141.42) / -2705.21 (167.10) / within at 0.0004 % of the steps |" in text
    assert "20 steps (published 2,500,000), 1 seed, reward_scale=1.0, shorter than published" in text
    assert "sawyer_peg (naive, fbrl, r3l, vaprl, oracle)" in text
    assert verdicts.RULE in text
    assert drawn(picture, COLOURS["naive"]) > 50
    assert drawn(picture, COLOURS["oracle"]) > 50
    assert drawn(picture, COLOURS["vaprl"]) == 0


def test_table_2_takes_the_lifetime_and_knows_bounds_and_missing_columns(tmp_path):
    folders = [
        write_run(tmp_path / "a", "sawyer_peg", "naive", [0.0, 0.0], 0.0015),
        write_run(tmp_path / "b", "sawyer_peg", "oracle", [0.0, 0.0], 0.5),
        write_run(tmp_path / "c", "sawyer_peg", "r3l", [0.0, 0.0], 0.0),
        write_run(tmp_path / "d", TABLETOP, "vaprl", [0.0, 0.0], 0.0094),
    ]
    csv_file, text_file, _ = paper_tables.write_table(2, folders, tmp_path / "out")
    found = {(row["env"], row["algo"]): row["verdict"] for row in table(csv_file) if row["mean"]}
    expected = {("sawyer_peg", "naive"): "above", ("sawyer_peg", "r3l"): "within", ("sawyer_peg", "oracle"): "-"}
    assert found == {**expected, (TABLETOP, "vaprl"): "within"}
    text = text_file.read_text()
    assert "0.0015 (0.0000) / <0.001 / above" in text
    assert "0.5000 (0.0000) / - / -" in text
    with pytest.raises(ValueError, match="choose from 1, 2"):
        paper_tables.write_table(3, folders, tmp_path / "out")


def test_another_kind_of_reward_is_not_compared(tmp_path):
    write_run(tmp_path / "a", TABLETOP, "naive", [-5.0], env_options={"reward_type": "dense"})
    row = next(row for row in paper_tables.table_rows(1, cells([tmp_path / "a"])) if row["mean"] is not None)
    assert (row["metric"], row["published_mean"], row["verdict"]) == ("deployed/return", "-", "-")


def test_curves_hold_means_intervals_crossings_and_areas(tmp_path):
    folders = [
        write_run(tmp_path / "a", TABLETOP, "fbrl", [[0.2, 1.0], [0.4, 0.6]], 0.004),
        write_run(tmp_path / "b", KITCHEN, "oracle", [[100.0, 300.0]], steps=(10, 40)),
    ]
    csv_file, text_file, picture = write_curves(folders, tmp_path / "new" / "out")
    rows = {(row["env"], row["metric"], int(row["step"])): row for row in table(csv_file)}
    last = rows[TABLETOP, "deployed/success", 20]
    assert [float(last[name]) for name in ("mean", "low", "high", "seeds")] == pytest.approx([0.8, 0.6, 1.0, 2])
    assert float(rows[TABLETOP, "deployed/success (trailing 10)", 20]["mean"]) == pytest.approx(0.55)
    assert float(rows[KITCHEN, "deployed/return", 40]["mean"]) == 300
    line = (
        "| tabletop_organization | fbrl | 2 | 20 | 20 | 0.86M | - | 2.07M | 0.550 (0.035) | 0.0040 (0.0000) | 0.005 |"
    )
    assert f"{line} 0.800 (0.141) | 0.94 |" in text_file.read_text()
    assert "| - | - | - | - | 250.0 (0.0) | 0.0000 (0.0000) | - | 300.0 (0.0) | 1203.88 |" in text_file.read_text()
    assert drawn(picture, COLOURS["fbrl"]) > 200
    assert drawn(picture, COLOURS["r3l"]) == 0


def test_methods_keep_their_order_and_colours_whoever_else_is_there():
    assert ordered(["oracle", "mine", "naive", "also", "oracle"], COLOURS) == ["naive", "oracle", "also", "mine"]
    assert colours(["oracle", "mine"])["oracle"] == COLOURS["oracle"]
    assert colours(["mine", "also"])["mine"] not in COLOURS.values()
