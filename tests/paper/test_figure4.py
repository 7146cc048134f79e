"""Figure 4 on small maps whose spread is known."""

import numpy as np
import pytest

from earl_jax.paper.figure4 import VisitMap, write_figure4
from tests.report.run_files import count_pixels, read_csv

SQUARE = np.array([[-1.0, -1.0], [1.0, 1.0]])


def visit_map(env="sawyer_peg", algo="fbrl", visits=None, map_bounds=SQUARE, unit="m"):
    visits = np.ones((1, 4, 4), int) if visits is None else visits
    return VisitMap(env=env, algo=algo, visits=visits, map_bounds=map_bounds, steps=100, unit=unit)


def test_spreads_are_measured_and_compared_with_the_oracle(tmp_path):
    narrow, wide, empty = np.zeros((2, 4, 4), int), np.ones((2, 4, 4), int), np.zeros((2, 4, 4), int)
    narrow[:, 1, 3] = [5, 6]
    maps = [
        visit_map("minitaur_pen", "oracle", narrow),
        visit_map("tabletop_organization", "fbrl", empty),
        visit_map("minitaur_pen", "fbrl", wide),
    ]
    csv_file, visits_file, text_file, picture = write_figure4(maps, tmp_path / "out")
    rows = read_csv(csv_file)
    assert [(row["env"], row["algo"]) for row in rows[::2]] == [maps[i].name for i in (1, 2, 0)]
    assert [(row["seed"], row["visits"], row["bins"], row["x_low"]) for row in rows[4:]] == [
        ("0", "5", "4", "-1.0"), ("1", "6", "4", "-1.0"),
    ]  # fmt: skip
    visits = read_csv(visits_file)
    assert len(visits) == 17
    assert list(visits[-1].values()) == ["minitaur_pen", "oracle", "1", "3", "11"]
    text = text_file.read_text()
    assert "| minitaur_pen | 1.000 [1.000, 1.000] | as published |" in text
    assert "| tabletop_organization | - | - (no oracle) |" in text
    assert "| minitaur_pen | oracle | 2 | 100 | 0.062 (0.000) | 0.000 (0.000) | 1.000 (0.000) |" in text
    assert count_pixels(picture, "#FDE725") > 500


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
