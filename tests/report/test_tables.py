"""Tables and plots on curves written by hand."""

import csv

import numpy as np
import pytest

from earl_jax.algos import make_algo
from earl_jax.envs import make
from earl_jax.protocol import Continuing
from earl_jax.report import tables
from earl_jax.report.plots import plot_runs
from earl_jax.report.runs import read, read_all
from earl_jax.runs.config import RunConfig
from earl_jax.runs.folder import RunFolder


def write_run(
    path, algo="naive", seeds=(0, 1), success=(0.0, 0.5, 1.0), recent=(0.0, 0.01, 0.02), setting=None, **options
):
    env, method = make("tabletop_organization"), make_algo(algo, **options)
    config = RunConfig.of(env, method, seeds, 30, 10, 10, 30, setting)
    folder = RunFolder.create(path, config)
    lifetime = np.cumsum(recent) / np.arange(1, 4)
    for number, step in enumerate((10, 20, 30)):
        metrics = {
            "deployed/success": np.full(len(seeds), success[number]) + 0.1 * np.arange(len(seeds)),
            "deployed/return": np.zeros(len(seeds)),
            "continuing/reward": np.full(len(seeds), lifetime[number]),
            "continuing/recent": np.full(len(seeds), recent[number]),
        }
        folder.append(config.rows(step, metrics))
    return path


def test_a_row_holds_what_the_curves_say(tmp_path):
    row = tables.tabulate([write_run(tmp_path / "a")])[0]
    assert row["deployed"] == pytest.approx(1.05)
    assert row["continuing"] == pytest.approx(0.01)
    assert row["seeds"] == 2
    assert row["steps"] == 30
    assert row["published_deployed"] == "0.32 (0.17)"
    assert row["steps_per_reward"] == pytest.approx(1 / 0.02)
    assert tables.tabulate([tmp_path / "a"], last=3)[0]["deployed"] == pytest.approx(0.55)


def test_runs_of_another_setting_stand_apart_from_the_published(tmp_path):
    write_run(tmp_path / "a")
    other = write_run(tmp_path / "b", setting=Continuing(goal_change=7))
    plain, continuing = tables.tabulate([tmp_path / "a", other])
    assert (plain["algo"], plain["published_deployed"]) == (
        "naive (goal_change=default, setting=default)",
        "0.32 (0.17)",
    )
    assert (continuing["algo"], continuing["published_deployed"]) == ("naive (goal_change=7, setting=continuing)", None)
    assert continuing["options"] == "goal_change=7, setting=continuing"


def test_crossings_read_the_trailing_mean():
    steps, curve = np.arange(1, 31) * 10, np.concatenate([np.zeros(10), np.ones(20)])
    assert tables.crossing(steps, curve, 0.5) == 150
    assert tables.crossing(steps, curve, 0.9) == 190
    assert tables.crossing(steps, 0.4 * curve, 0.5) is None


def test_seeds_of_equal_runs_are_pooled_and_others_kept_apart(tmp_path):
    paths = [
        write_run(tmp_path / "a"),
        write_run(tmp_path / "b", seeds=(2, 3, 4)),
        write_run(tmp_path / "c", reward_scale=1.0),
    ]
    pooled, other = read_all(paths)
    assert pooled.metrics["deployed/success"].shape == (5, 3)
    assert other.metrics["deployed/success"].shape == (2, 3)
    text = tables.markdown(tables.tabulate(paths))
    assert "| naive (reward_scale=default) |" in text
    assert "| naive (reward_scale=1.0) |" in text
    assert "naive (reward_scale=1.0): reward_scale=1.0" in text


def test_a_run_cut_within_an_evaluation_is_read_up_to_the_last_whole_one(tmp_path):
    path = write_run(tmp_path / "a")
    text = (path / "metrics.csv").read_text()
    (path / "metrics.csv").write_text(text[: text.rindex("\n", 0, -1) + 5])
    np.testing.assert_array_equal(read(path).steps, [10, 20])


def test_tables_are_written_as_markdown_and_csv(tmp_path):
    rows = tables.tabulate([write_run(tmp_path / "a")])
    tables.write(rows, tmp_path / "t.csv")
    with (tmp_path / "t.csv").open() as handle:
        assert next(csv.DictReader(handle))["published_continuing"] == "0.012 (0.004)"
    tables.write(rows, tmp_path / "t.md")
    assert "1.050 (0.035)" in (tmp_path / "t.md").read_text()
    with pytest.raises(ValueError, match=r"\.md or \.csv"):
        tables.write(rows, tmp_path / "t.txt")


def test_a_plot_has_a_line_a_method_and_both_panels(tmp_path, monkeypatch):
    from matplotlib.figure import Figure

    drawn = []
    monkeypatch.setattr(Figure, "savefig", lambda figure, *_, **__: drawn.append(figure))
    paths = [write_run(tmp_path / "a", seeds=(0, 1, 2)), write_run(tmp_path / "b", "fbrl", seeds=(0, 1, 2))]
    plot_runs(paths, tmp_path / "x.png")
    deployed, continuing = drawn[0].axes
    assert [text.get_text() for text in drawn[0].legends[0].get_texts()] == ["naive, 3 seeds", "fbrl, 3 seeds"]
    np.testing.assert_allclose(deployed.lines[0].get_ydata(), [0.1, 0.6, 1.1])
    np.testing.assert_allclose(continuing.lines[1].get_ydata(), [0, 0.005, 0.01])
    with pytest.raises(ValueError, match=r"\.png, \.pdf, \.svg"):
        plot_runs(paths, tmp_path / "x.bmp")


def test_nothing_to_read_is_said(tmp_path):
    path = write_run(tmp_path / "a")
    (path / "metrics.csv").unlink()
    with pytest.raises(ValueError, match="no evaluation yet"):
        read(path)
    with pytest.raises(ValueError, match="at least one run folder"):
        read_all([])
