"""Plots of run folders, on curves written by hand."""

import numpy as np
import pytest

from earl_jax.report.plots import plot_runs
from tests.report.run_files import TABLETOP, write_run


def test_a_plot_has_a_line_per_method_in_both_panels(tmp_path, monkeypatch):
    from matplotlib.figure import Figure

    figures = []
    monkeypatch.setattr(Figure, "savefig", lambda figure, *_, **__: figures.append(figure))
    success = np.array([0.0, 0.5, 1.0]) + 0.1 * np.arange(3)[:, None]
    reward = {"continuing/reward": [0.0, 0.005, 0.01]}
    paths = [write_run(tmp_path / algo, TABLETOP, algo, success, metrics=reward) for algo in ("naive", "fbrl")]
    plot_runs(paths, tmp_path / "x.png")
    deployed, continuing = figures[0].axes
    assert [text.get_text() for text in figures[0].legends[0].get_texts()] == ["naive, 3 seeds", "fbrl, 3 seeds"]
    np.testing.assert_allclose(deployed.lines[0].get_ydata(), [0.1, 0.6, 1.1])
    np.testing.assert_allclose(continuing.lines[1].get_ydata(), [0, 0.005, 0.01])


def test_a_metric_takes_the_place_of_the_deployed_one(tmp_path, monkeypatch):
    from matplotlib.figure import Figure

    figures = []
    monkeypatch.setattr(Figure, "savefig", lambda figure, *_, **__: figures.append(figure))
    metrics = {"continuing/reward": 0.0, "continuing/alive": [1, 1, 0]}
    path = write_run(tmp_path / "a", TABLETOP, "fbrl", np.zeros((3, 3)), metrics=metrics)
    plot_runs([path], tmp_path / "x.png", "continuing/alive")
    axis = figures[0].axes[0]
    np.testing.assert_allclose(axis.lines[0].get_ydata(), [1, 1, 0])
    assert (axis.get_title(), axis.get_ylabel()) == ("continuing/alive", "alive")
    assert axis.get_ylim() == (-0.03, 1.03)


def test_an_unknown_picture_format_is_refused(tmp_path):
    with pytest.raises(ValueError, match=r"\.png, \.pdf, \.svg"):
        plot_runs([tmp_path], tmp_path / "x.bmp")
