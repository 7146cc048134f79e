"""Plots of run folders, on curves written by hand."""

import numpy as np
import pytest

from earl_jax.report.plots import caption, plot_runs
from tests.cli.process import run
from tests.report.run_files import DOOR, TABLETOP, rising, write_run


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


REWARD = {"continuing/reward": [0.0, 0.005, 0.01], "interventions": [1.0, 2.0, 3.0]}


@pytest.fixture
def sweep(tmp_path):
    """A folder of three runs, two methods on tabletop and one of them on the door."""
    for env, algo in ((TABLETOP, "naive"), (TABLETOP, "fbrl"), (DOOR, "fbrl")):
        write_run(tmp_path / env / algo, env, algo, rising(3, 3), metrics=REWARD)
    return tmp_path


def drawn(monkeypatch, *arguments, **options):
    """Return the figure that `plot_runs` makes."""
    from matplotlib.figure import Figure

    figures = []
    monkeypatch.setattr(Figure, "savefig", lambda figure, *_, **__: figures.append(figure))
    plot_runs(*arguments, **options)
    return figures[0]


def texts(figure):
    return [text.get_text() for text in figure.legends[0].get_texts()]


def test_a_sweep_has_panels_for_each_task_and_one_colour_for_a_method(sweep, tmp_path, monkeypatch):
    figure = drawn(monkeypatch, [sweep], tmp_path / "x.pdf")
    assert [axis.get_title() for axis in figure.axes][::2] == [f"{env}\nDeployed, from s0" for env in (TABLETOP, DOOR)]
    assert texts(figure) == ["fbrl, 3 seeds", "naive, 3 seeds"]
    fbrl = [line.get_color() for axis in figure.axes for line in axis.lines[:1]]
    assert set(fbrl) == {"C0"}


def test_a_metric_smoothing_and_labels(sweep, tmp_path, monkeypatch):
    options = {"names": ["no resets", "there and back"], "metric": "interventions", "smooth": 2}
    figure = drawn(monkeypatch, [sweep / TABLETOP], tmp_path / "x.svg", **options)
    [axis] = figure.axes
    assert texts(figure) == ["no resets, 3 seeds", "there and back, 3 seeds"]
    assert axis.get_ylabel() == "interventions"
    np.testing.assert_allclose(axis.lines[0].get_ydata(), [1.0, 1.5, 2.5])
    assert "trailing 2 evaluations" in caption(2)
    assert "No smoothing" in caption()


def test_a_share_is_drawn_from_0_to_1(tmp_path, monkeypatch):
    metrics = {"continuing/reward": 0.0, "continuing/alive": [1, 1, 0]}
    path = write_run(tmp_path / "a", TABLETOP, "fbrl", rising(3, 3), metrics=metrics)
    [axis] = drawn(monkeypatch, [path], tmp_path / "x.png", metric="continuing/alive").axes
    np.testing.assert_allclose(axis.lines[0].get_ydata(), [1, 1, 0])
    assert axis.get_ylim() == (-0.03, 1.03)


def test_lines_beyond_ten_colours_are_dashed_and_long_names_are_wrapped(tmp_path, monkeypatch):
    for number in range(11):
        options = {"discount": 0.9 + number / 1000, "learning_rate": 1e-3}
        write_run(tmp_path / str(10 + number), TABLETOP, "naive", rising(3, 3), metrics=REWARD, **options)
    write_run(tmp_path / "default", TABLETOP, "naive", rising(3, 3), metrics=REWARD)
    figure = drawn(monkeypatch, [tmp_path], tmp_path / "x.pdf", size="column")
    lines = figure.axes[0].lines
    assert len({(line.get_color(), line.get_linestyle()) for line in lines}) == 12
    assert texts(figure)[0] == "naive (discount=0.9, learning_rate=0.001), 3\nseeds"
    figure.canvas.draw()
    box = figure.legends[0].get_window_extent()
    assert box.x0 >= 0
    assert box.x1 <= figure.bbox.width
    assert figure.axes[0].get_window_extent().height > figure.dpi  # the legend takes nothing from the panels


@pytest.mark.parametrize(("size", "width", "columns"), [("column", 3.35, 1), ("page", 6.9, 2), ("screen", 10, 2)])
def test_sizes_are_those_of_a_paper(sweep, tmp_path, monkeypatch, size, width, columns):
    figure = drawn(monkeypatch, [sweep / DOOR], tmp_path / "x.pdf", size=size)
    assert figure.get_size_inches()[0] == width
    assert figure.axes[0].get_gridspec().ncols == columns
    points = {"screen": 10}.get(size, 8)
    assert figure.axes[0].xaxis.label.get_size() == points


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"names": ["one"]}, "1 labels for 2 runs; give one for each of: fbrl; naive"),
        ({"metric": "speed"}, "has no column 'speed'; it has"),
        ({"smooth": 0}, "smooth at least 1"),
    ],
)
def test_what_cannot_be_drawn_is_refused(sweep, tmp_path, options, message):
    with pytest.raises(ValueError, match=message):
        plot_runs([sweep / TABLETOP], tmp_path / "x.png", **options)


def test_the_command_says_that_it_replaces_a_picture(sweep, tmp_path):
    out = tmp_path / "a.png"
    code, printed, err = run("plot", sweep, "--out", out, "--size", "column", "--smooth", "10")
    assert (code, err) == (0, "")
    assert f"{out}\nMeans over seeds" in printed
    assert "trailing 10 evaluations" in printed
    assert f"earl-jax: replaced {out} of 20" in run("plot", sweep / DOOR, "--out", out)[2]


def test_an_unknown_picture_format_is_refused(tmp_path):
    with pytest.raises(ValueError, match=r"\.png, \.pdf, \.svg"):
        plot_runs([tmp_path], tmp_path / "x.bmp")
