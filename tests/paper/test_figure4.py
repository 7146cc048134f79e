"""Figure 4 on small maps whose distances and spread are known."""

import numpy as np
import pytest

from earl_jax.envs import make
from earl_jax.paper import figure4
from earl_jax.paper.figure4 import verdicts, write_figure4
from earl_jax.paper.figure4_picture import difference
from earl_jax.paper.visit_maps import VISITS, VisitMap, read_maps, write_maps
from earl_jax.report.style import COLOURS
from tests.report.run_files import count_pixels, read_csv

SQUARE = np.array([[-1.0, -1.0], [1.0, 1.0]])


def visit_map(env="sawyer_peg", algo="fbrl", visits=None, map_bounds=SQUARE, unit="m", **places):
    visits = np.ones((1, 4, 4), int) if visits is None else visits
    return VisitMap(env=env, algo=algo, visits=visits, map_bounds=map_bounds, steps=100, unit=unit, **places)


def pen_maps(fbrl, oracle):
    """Return maps of the pen with a start and a goal in the middle of a bin; each seed has one bin per method."""
    places = {"starts": np.array([[-0.75, -0.75]]), "goals": np.array([[0.25, -0.75]])}
    maps = []
    for algo, bins in (("oracle", oracle), ("fbrl", fbrl)):
        visits = np.zeros((len(bins), 4, 4), int)
        for seed, (x, y) in enumerate(bins):
            visits[seed, x, y] = 10
        maps.append(visit_map("minitaur_pen", algo, visits, **places))
    return maps


def test_visits_are_measured_and_compared_with_the_oracle(tmp_path):
    far, near = [(0, 3), (1, 3), (0, 3), (0, 2)], [(0, 0), (2, 0), (2, 0), (1, 0)]
    empty = visit_map("tabletop_organization", "fbrl", np.zeros((2, 4, 4), int))
    maps = [*pen_maps(far, near), empty]
    csv_file, visits_file, text_file, picture = write_figure4(maps, tmp_path / "out")
    rows = read_csv(csv_file)
    assert [(row["env"], row["algo"]) for row in rows] == [empty.name] * 2 + [maps[1].name] * 4 + [maps[0].name] * 4
    assert [float(row["distance"]) for row in rows[2:6]] == [1.5, pytest.approx(np.hypot(0.5, 1.5)), 1.5, 1.0]
    assert [float(row["distance"]) for row in rows[6:]] == [0, 0, 0, 0.5]
    assert (rows[0]["distance"], rows[2]["visits"], rows[2]["bins"], rows[2]["x_low"]) == ("", "10", "4", "-1.0")
    assert list(read_csv(visits_file)[0].values()) == ["minitaur_pen", "fbrl", "0", "0", "3", "10"]
    text = text_file.read_text()
    assert "| minitaur_pen | distance | 1.395 | 0.125 | 1.270 [" in text
    assert "| fbrl | as published |" in text
    assert "No test on tabletop_organization: no map of oracle." in text
    assert count_pixels(picture, COLOURS["fbrl"]) > 500


@pytest.mark.parametrize(
    ("fbrl", "oracle", "word"),
    [
        ([(0, 0), (2, 0), (1, 0)], [(0, 3), (1, 3), (0, 3)], "opposite to published"),
        ([(0, 0), (0, 3), (1, 0)], [(0, 1), (0, 3), (2, 0)], "no clear difference"),
        ([(0, 3)], [(0, 0)], "as published, not tested"),
    ],
)
def test_a_verdict_needs_a_clear_difference(fbrl, oracle, word):
    assert f"| fbrl | {word} |" in figure4._markdown(pen_maps(fbrl, oracle))


def test_the_claims_of_the_peg_are_its_distance_and_the_oracle_around_the_box():
    env = make("sawyer_peg")
    at_goal, far = np.zeros((2, 2, 64, 64), int)
    at_goal[:, 23:25, 32] = [[9, 1], [8, 2]]
    far[:, 60, 60], far[0, 0, 0] = 9, 1
    maps = [
        visit_map("sawyer_peg", algo, visits, env.map_bounds, starts=env.map_starts, goals=env.map_goals)
        for algo, visits in (("fbrl", far), ("oracle", at_goal))
    ]
    claims = {verdict.measure: verdict for verdict in verdicts(maps)}
    assert (claims["near_goal"].fbrl, claims["near_goal"].oracle, claims["near_goal"].agrees) == (0, 1, True)
    assert claims["distance"].agrees
    assert claims.keys() == {"near_goal", "distance"}


def test_the_difference_is_the_oracles_share_minus_the_others_above_a_threshold():
    oracle, fbrl = pen_maps([(0, 3), (0, 3)], [(0, 0), (2, 0)])
    expected = np.zeros((4, 4))
    expected[0, 0] = expected[2, 0] = 1
    expected[0, 3] = -1
    np.testing.assert_array_equal(difference(oracle, fbrl), expected)
    even = visit_map(visits=np.full((1, 4, 4), 100))
    slightly = visit_map(visits=np.full((1, 4, 4), 100) + np.eye(4, dtype=int))
    assert not difference(slightly, even).any()


def test_maps_are_read_again_and_those_without_seeds_are_pooled(tmp_path):
    maps = pen_maps([(0, 3), (1, 3)], [(0, 0), (2, 0)])
    write_maps(maps[::-1], tmp_path)
    for written, read in zip(maps[::-1], read_maps(tmp_path), strict=True):
        assert (read.name, read.steps, read.seeds, read.pooled) == (written.name, 100, 2, None)
        np.testing.assert_array_equal(read.visits, written.visits)
        np.testing.assert_array_equal(read.map_bounds, SQUARE)
    (tmp_path / VISITS).write_text("env,algo,x_bin,y_bin,visits\nminitaur_pen,fbrl,1,2,7\n")
    pooled = read_maps(tmp_path)[0]
    assert (pooled.seeds, pooled.pooled, pooled.visits.sum(), pooled.visits[0, 1, 2]) == (2, 2, 7, 7)


def test_a_map_has_x_to_the_right_and_y_upwards(tmp_path, monkeypatch):
    from matplotlib.figure import Figure

    figures = []
    monkeypatch.setattr(Figure, "savefig", lambda figure, *_, **__: figures.append(figure))
    visits = np.zeros((1, 4, 4), int)
    visits[0, 3, 0] = 9
    write_figure4([visit_map(visits=visits, map_bounds=[[0, 10], [4, 20]], unit="cm")], tmp_path)
    axis = figures[0].axes[0]
    image = axis.images[0]
    assert image.get_extent() == [0, 4, 10, 20]
    assert image.origin == "lower"
    np.testing.assert_array_equal(np.argwhere(~image.get_array().mask), [[0, 3]])
    assert (axis.get_title(), axis.get_xlabel(), axis.get_ylabel()) == ("Sawyer peg, fbrl", "x, cm", "y, cm")


def test_invalid_maps_are_refused(tmp_path):
    with pytest.raises(ValueError, match="has one map"):
        write_figure4([visit_map(), visit_map()], tmp_path)
    with pytest.raises(ValueError, match=r"expected \[N, B, B\]"):
        write_figure4([visit_map(visits=np.ones((4, 4)))], tmp_path)
    with pytest.raises(ValueError, match="at least one map"):
        write_figure4([], tmp_path)
