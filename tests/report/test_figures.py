"""Figures 2, 4 and 5 on small numbers whose answers are known."""

import numpy as np
import pytest

from earl_jax.paper.figure2 import verdict, write_figure2
from earl_jax.paper.figure4 import Map, write_figure4
from earl_jax.paper.figure5 import figure_rows, write_figure5
from earl_jax.report.style import COLOURS
from tests.report.test_paper import drawn, table, write_run

SQUARE = np.array([[-1.0, -1.0], [1.0, 1.0]])


def world(horizon):
    return {} if horizon == 100_000 else {"train_horizon": horizon}


def test_figure_2_finds_what_degrades_and_what_the_biased_update_restores(tmp_path):
    returns = {
        True: {1_000: [500.0, 520.0], 100_000: [100.0, 120.0]},
        False: {1_000: [500.0, 500.0], 100_000: [480.0, 530.0]},
    }
    folders = [
        write_run(
            tmp_path / f"{arm}{horizon}",
            "cheetah_run",
            "naive",
            scores,
            env_options=world(horizon),
            timeout_bootstrap=arm,
        )
        for arm, points in returns.items()
        for horizon, scores in points.items()
    ]
    lanes = {"env_options": world(1_000), "timeout_bootstrap": [False, True, True]}
    folders.append(write_run(tmp_path / "fish", "fish_swim", "naive", [7.0, 8.0, 9.0], **lanes))
    csv_file, text_file, picture = write_figure2(folders, tmp_path / "out")
    rows = {(row["env"], row["timeout_bootstrap"], row["train_horizon"]): row for row in table(csv_file)}
    assert len(rows) == 6
    point = rows["cheetah_run", "True", "100000"]
    assert [float(point[name]) for name in ("return", "low", "high", "seeds")] == [110, 100, 120, 2]
    assert float(rows["fish_swim", "True", "1000"]["return"]) == 8.5
    assert float(rows["fish_swim", "False", "1000"]["return"]) == 7
    text = text_file.read_text()
    assert "biased update | 1,000 and 100,000 | 400.0 [380.0, 420.0] | degrades | degrades | agrees |" in text
    assert "| -5.0 [-30.0, 20.0] | no difference told | restored | agrees |" in text
    assert "| cheetah_run | 100,000 | 395.0 [360.0, 430.0] | helps |" in text
    assert "- cheetah_run, with the biased update: 2,000; 5,000; 10,000; 20,000; 200,000" in text
    assert drawn(picture, "#D55E00") > 100
    assert drawn(picture, "#0072B2") > 100


def test_figure_2_verdicts_need_evidence():
    assert verdict("no difference told", "helps", "degrades") == "not told"
    assert verdict("improves", "helps", "degrades") == "differs"
    assert verdict("no difference told", "no difference told", "restored") == "not told"
    assert verdict("degrades", "helps", "restored") == "differs"
    assert verdict("-", "helps", "restored") == verdict("degrades", "-", None) == "-"


def test_figure_2_takes_naive_alone_and_one_run_a_point(tmp_path):
    oracle = write_run(tmp_path / "a", "fish_swim", "oracle", [1.0])
    with pytest.raises(ValueError, match="runs of naive, not of oracle"):
        write_figure2([oracle], tmp_path / "out")
    twice = [write_run(tmp_path / f"b{scale}", "fish_swim", "naive", [1.0], reward_scale=scale) for scale in (1.0, 2.0)]
    with pytest.raises(ValueError, match=r"H_T 100,000, with the biased update, differ in other options"):
        write_figure2(twice, tmp_path / "out")


def test_figure_4_compares_spreads_and_can_be_drawn_again(tmp_path):
    narrow, wide = np.zeros((2, 4, 4), int), np.ones((2, 4, 4), int)
    narrow[:, 1, 3] = [5, 6]
    maps = [
        Map("minitaur_pen", "oracle", narrow, SQUARE, 100),
        Map("tabletop_organization", "fbrl", np.zeros((2, 4, 4), int), SQUARE, 100),
        Map("minitaur_pen", "fbrl", wide, SQUARE, 100),
    ]
    csv_file, visits_file, text_file, picture = write_figure4(maps, tmp_path / "out")
    rows = table(csv_file)
    assert [(row["env"], row["algo"]) for row in rows[::2]] == [(maps[i].env, maps[i].algo) for i in (1, 2, 0)]
    assert [(row["seed"], row["visits"], row["bins"], row["x_low"]) for row in rows[4:]] == [
        ("0", "5", "4", "-1.0"), ("1", "6", "4", "-1.0"),
    ]  # fmt: skip
    visits = table(visits_file)
    assert len(visits) == 17
    assert list(visits[-1].values()) == ["minitaur_pen", "oracle", "1", "3", "11"]
    text = text_file.read_text()
    assert "| minitaur_pen | 1.000 [1.000, 1.000] | as published |" in text
    assert "| tabletop_organization | - | - (no oracle) |" in text
    assert "| minitaur_pen | oracle | 2 | 100 | 0.062 (0.000) | 0.000 (0.000) | 1.000 (0.000) |" in text
    assert drawn(picture, "#FDE725") > 500


def test_a_map_has_x_to_the_right_and_y_upwards(tmp_path, monkeypatch):
    from matplotlib.figure import Figure

    kept = []
    monkeypatch.setattr(Figure, "savefig", lambda figure, *_, **__: kept.append(figure))
    visits = np.zeros((1, 4, 4), int)
    visits[0, 3, 0] = 9
    write_figure4([Map("sawyer_peg", "fbrl", visits, [[0, 10], [4, 20]], 1)], tmp_path)
    image = kept[0].axes[0].images[0]
    assert image.get_extent() == [0, 4, 10, 20]
    assert image.origin == "lower"
    np.testing.assert_array_equal(np.argwhere(~image.get_array().mask), [[0, 3]])


def test_maps_that_do_not_fit_are_refused(tmp_path):
    fine = Map("sawyer_peg", "fbrl", np.ones((1, 4, 4), int), SQUARE, 1)
    with pytest.raises(ValueError, match="one map each"):
        write_figure4([fine, fine], tmp_path)
    with pytest.raises(ValueError, match=r"expected \[N, B, B\]"):
        write_figure4([fine._replace(visits=np.ones((4, 4)))], tmp_path)
    with pytest.raises(ValueError, match="at least one map"):
        write_figure4([], tmp_path)


def starts(algo, initial, uniform):
    pairs = zip(initial, uniform, strict=True)
    return [{"algo": algo, "seed": i, "success_initial": a, "success_uniform": b} for i, (a, b) in enumerate(pairs)]


def test_figure_5_judges_drops_by_our_interval(tmp_path):
    rows = [
        *starts("oracle", [1.0, 0.8], [0.5, 0.5]),
        *starts("fbrl", [1.0, 1.0], [0.5, 0.6]),
        *starts("vaprl", [1.0, 1.0], [1.0, 1.0]),
        *starts("r3l", [0.0, 0.0], [0.0, 0.1]),
    ]
    csv_file, seeds_file, text_file, picture = write_figure5(rows, tmp_path / "out")
    found = {row["algo"]: row for row in table(csv_file)}
    assert list(found) == ["fbrl", "r3l", "vaprl", "oracle"]
    oracle = [
        float(found["oracle"][name])
        for name in ("initial", "uniform", "drop", "drop_low", "drop_high", "published_drop")
    ]
    assert oracle == pytest.approx([0.9, 0.5, 4 / 9, 0.375, 0.5, 0.374])
    assert {algo: row["verdict"] for algo, row in found.items()} == {
        "oracle": "larger", "fbrl": "larger", "vaprl": "smaller", "r3l": "-",
    }  # fmt: skip
    assert [{**row, **{name: str(row[name]) for name in list(row)[1:]}} for row in rows] == table(seeds_file)
    text = text_file.read_text()
    assert "| oracle | 2 | 0.900 [0.800, 1.000] | 0.500 [0.500, 0.500] | 44.4 [37.5, 50.0] | 37.4 % | larger |" in text
    assert drawn(picture, COLOURS["fbrl"]) > 1000


def test_figure_5_within_alone_and_without_rows(tmp_path):
    inside = figure_rows(starts("oracle", [1.0, 1.0], [0.5, 0.7]))[0]
    assert (inside["verdict"], inside["drop"]) == ("within", pytest.approx(0.4))
    assert figure_rows(starts("oracle", [1.0], [0.6]))[0]["verdict"] == "-"
    with pytest.raises(ValueError, match="at least one row"):
        figure_rows([])
    with pytest.raises(ValueError, match="success_uniform"):
        figure_rows([{"algo": "fbrl", "seed": 0, "success_initial": 1.0}])
