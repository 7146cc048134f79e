"""Figure 3 on small maps whose distances and spread are known."""

import numpy as np
import pytest

from earl_jax.envs import Map
from earl_jax.paper.figure3 import VisitMap, difference, report_of, seed_rows, verdicts, word
from earl_jax.report.style import COLOURS
from tests.report.run_files import count_pixels, read_csv

PEN = {"starts": np.array([[-0.75, -0.75]]), "goals": np.array([[0.25, -0.75]])}
"""A start and a goal in the middle of a bin of a map of 4 by 4 bins."""


def task_map(bounds=((-1.0, -1.0), (1.0, 1.0)), **fields):
    return Map(lambda obs: obs[..., :2], np.array(bounds), **fields)


def pen_maps(fbrl, oracle):
    """Return maps of the pen; each seed has all visits in one bin per method."""
    maps = []
    for algo, bins in (("oracle", oracle), ("fbrl", fbrl)):
        visits = np.zeros((len(bins), 4, 4), int)
        for seed, (x, y) in enumerate(bins):
            visits[seed, x, y] = 10
        maps.append(VisitMap("minitaur_pen", task_map(**PEN), algo, visits))
    return maps


def claims_of(*maps):
    return {row["measure"]: row for row in verdicts([row for part in maps for row in seed_rows(part)])}


def test_visits_are_measured_and_compared_with_the_oracle(tmp_path):
    oracle, fbrl = pen_maps([(0, 3), (1, 3), (0, 3), (0, 2)], [(0, 0), (2, 0), (2, 0), (1, 0)])
    empty = VisitMap("tabletop_organization", task_map(), "fbrl", np.zeros((2, 4, 4), int))
    csv_file, visits_file, text_file, picture = report_of([oracle, fbrl, empty]).write("figure3", tmp_path / "out")
    rows = read_csv(csv_file)
    names = [("tabletop_organization", "fbrl")] * 2 + [("minitaur_pen", "fbrl")] * 4 + [("minitaur_pen", "oracle")] * 4
    assert [(row["env"], row["algo"]) for row in rows] == names
    assert [float(row["distance"]) for row in rows[2:6]] == [1.5, pytest.approx(np.hypot(0.5, 1.5)), 1.5, 1.0]
    assert [float(row["distance"]) for row in rows[6:]] == [0, 0, 0, 0.5]
    assert (rows[0]["distance"], rows[2]["steps"], rows[2]["bins"], rows[2]["x_low"]) == ("", "10", "4", "-1.0")
    assert list(read_csv(visits_file)[0].values()) == ["minitaur_pen", "fbrl", "0", "0", "3", "10"]
    text = text_file.read_text()
    assert "| minitaur_pen | distance | 1.395 | 0.125 | 1.270 [" in text
    assert "| as published |" in text
    assert "No test on tabletop_organization: no map of oracle." in text
    assert count_pixels(picture, COLOURS["fbrl"]) > 500


@pytest.mark.parametrize(
    ("fbrl", "oracle", "expected"),
    [
        ([(0, 0), (0, 0), (0, 0)], [(0, 0), (0, 0), (0, 0)], "cannot tell: all seeds are equal"),
        ([(0, 3)], [(0, 0)], "as published, not tested"),
    ],
)
def test_a_verdict_needs_a_clear_difference(fbrl, oracle, expected):
    assert word(claims_of(*pen_maps(fbrl, oracle))["distance"]) == expected


def test_runs_that_end_at_different_steps_are_not_tested():
    oracle, fbrl = pen_maps([(0, 3), (1, 3), (0, 3)], [(0, 0), (2, 0), (2, 0)])
    fault = fbrl._replace(visits=np.concatenate([fbrl.visits, fbrl.visits[:1] // 2]))
    assert word(claims_of(oracle, fault)["distance"]) == "as published"
    longer = report_of([oracle._replace(visits=2 * oracle.visits), fbrl]).parts["verdicts"]
    assert longer.endswith("| - | - | - | not tested: the runs end at different steps |")


def test_the_difference_is_the_oracles_share_minus_the_others_above_a_threshold():
    oracle, fbrl = pen_maps([(0, 3), (0, 3)], [(0, 0), (2, 0)])
    expected = np.zeros((4, 4))
    expected[0, 0] = expected[2, 0] = 1
    expected[0, 3] = -1
    np.testing.assert_array_equal(difference(oracle.shares, fbrl.shares), expected)
    even = np.full((4, 4), 1 / 16)
    assert not difference(even + 1e-4 * np.eye(4), even).any()


def test_a_map_has_x_to_the_right_and_y_upwards():
    visits = np.zeros((1, 4, 4), int)
    visits[0, 3, 0] = 9
    drawn = task_map([[0, 10], [4, 20]], unit="cm")
    axis = report_of([VisitMap("sawyer_peg", drawn, "fbrl", visits)]).figure.axes[0]
    image = axis.images[0]
    assert image.get_extent() == [0, 4, 10, 20]
    assert image.origin == "lower"
    np.testing.assert_array_equal(np.argwhere(~image.get_array().mask), [[0, 3]])
    assert (axis.get_title(), axis.get_xlabel(), axis.get_ylabel()) == ("Sawyer peg, FBRL", "x, cm", "y, cm")


@pytest.mark.parametrize("count", [0, 2])
def test_each_task_and_method_has_one_map(count):
    with pytest.raises(ValueError, match="needs one map of visits for each task and method"):
        report_of([VisitMap("sawyer_peg", task_map(), "fbrl", np.ones((1, 4, 4), int))] * count)
