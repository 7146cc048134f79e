"""Plots of run folders, on curves written by hand."""

import numpy as np
import pytest

from earl_jax.metrics.phase_stats import ALIVE, FORWARD
from earl_jax.report import plots
from earl_jax.report.plots import RELEASED, caption, plot_runs
from earl_jax.report.published import released_curves
from earl_jax.report.scores import trailing
from earl_jax.report.style import COLOURS, colours, method_order, task_title
from earl_jax.runs.files import RunWarning
from tests.cli.process import run, succeed
from tests.report.run_files import DOOR, TABLETOP, rising, write_run

METRICS = {"continuing/reward": [0.0, 0.005, 0.01], "interventions": [1, 2, 3], ALIVE: [1, np.nan, 0], FORWARD: np.nan}


@pytest.fixture(scope="module")
def sweep(tmp_path_factory):
    """A folder of three runs, two methods on tabletop and one of them on the door."""
    root = tmp_path_factory.mktemp("sweep")
    for env, algo in ((TABLETOP, "naive"), (TABLETOP, "fbrl"), (DOOR, "fbrl")):
        write_run(root / env / algo, env, algo, rising(3, 3), metrics=METRICS)
    return root


@pytest.fixture
def drawn(monkeypatch, tmp_path):
    """A function that returns the figure that `plot_runs` makes."""
    from matplotlib.figure import Figure

    figures = []
    monkeypatch.setattr(Figure, "savefig", lambda figure, *_, **__: figures.append(figure))

    def draw(*folders, **options):
        plot_runs(folders, str(tmp_path / "x.pdf"), **options)
        figures[-1].draw_without_rendering()
        return figures[-1]

    return draw


def texts(figure):
    return [text.get_text() for text in figure.legends[0].get_texts()]


def test_a_sweep_has_panels_for_each_task_and_one_colour_for_a_method(sweep, drawn):
    figure = drawn(sweep)
    titles = ["Tabletop organization\nDeployed, from s0", "Sawyer door\nDeployed, from s0"]
    assert [axis.get_title() for axis in figure.axes][::2] == titles
    assert texts(figure) == ["FBRL, 3 seeds", "Naive RL, 3 seeds"]
    deployed, continuing = figure.axes[:2]
    np.testing.assert_allclose(deployed.lines[0].get_ydata(), [0, 0.45, 0.9])
    np.testing.assert_allclose(continuing.lines[1].get_ydata(), [0, 0.005, 0.01])
    assert {axis.lines[0].get_color() for axis in figure.axes} == {COLOURS["fbrl"]}


def test_a_metric_smoothing_and_labels(sweep, drawn):
    names = ["no resets", "there and back"]
    figure = drawn(sweep / TABLETOP, names=names, metric="interventions", smooth=2)
    [axis] = figure.axes
    assert texts(figure) == ["no resets, 3 seeds", "there and back, 3 seeds"]
    assert (axis.get_ylabel(), axis.get_title()) == ("interventions", "")
    np.testing.assert_allclose(axis.lines[0].get_ydata(), [1.0, 1.5, 2.5])
    assert "trailing 2 evaluations" in caption(2)
    assert "No smoothing" in caption()
    [axis] = drawn(sweep / DOOR, metric=ALIVE).axes
    assert axis.get_ylim() == (-0.03, 1.03), "a share is drawn from 0 to 1"
    assert axis.lines[0].get_marker() == "o", "evaluations without neighbours are drawn as dots"


def test_lines_of_variants_have_colours_unlike_those_of_the_methods_beside_them(tmp_path, drawn, monkeypatch):
    for scale in (1.0, 2.0, 3.0):
        write_run(tmp_path / str(scale), TABLETOP, "fbrl", rising(3, 3), metrics=METRICS, reward_scale=scale)
    monkeypatch.setattr(plots, "CYCLE", {"C3": "naive", "C4": "", "C5": ""})
    assert [line.get_color() for line in drawn(tmp_path).axes[0].lines] == ["C3", "C4", "C5"]
    write_run(tmp_path / "naive", TABLETOP, "naive", rising(3, 3), metrics=METRICS)
    lines = drawn(tmp_path).axes[0].lines
    assert [line.get_color() for line in lines] == ["C4", "C5", "C4", COLOURS["naive"]]
    assert [line.get_linestyle() for line in lines] == ["-", "-", "--", "-"]


def test_lines_whose_styles_repeat_have_no_legend(tmp_path, drawn, monkeypatch):
    for scale in (1.0, 2.0):
        write_run(tmp_path / str(scale), TABLETOP, "fbrl", rising(3, 3), metrics=METRICS, reward_scale=scale)
    monkeypatch.setattr(plots, "CYCLE", {"C0": ""})
    assert drawn(tmp_path).legends
    monkeypatch.setattr(plots.style, "LINE_STYLES", ["-"])
    with pytest.warns(RunWarning, match="a picture of 2 lines has no legend, because their styles repeat"):
        assert not drawn(tmp_path).legends


def test_a_run_without_rewards_has_its_scores_alone_and_stands_beside_others(tmp_path, drawn):
    write_run(tmp_path / "own", TABLETOP, "fbrl", rising(3, 3))
    assert [axis.get_title() for axis in drawn(tmp_path).axes] == ["Deployed, from s0"]
    write_run(tmp_path / "naive", TABLETOP, "naive", rising(3, 3), metrics=METRICS)
    _, continuing = drawn(tmp_path).axes
    assert sorted(np.isfinite(line.get_ydata()).any() for line in continuing.lines) == [False, True]


def test_runs_of_a_task_by_success_and_by_return_have_panels_of_their_own(tmp_path, drawn):
    for reward in ("sparse", "dense"):
        options = {"reward_type": reward}
        write_run(tmp_path / reward, TABLETOP, "naive", rising(3, 3), metrics=METRICS, env_options=options)
    labels = [axis.get_ylabel().partition(" ")[0] for axis in drawn(tmp_path).axes]
    assert labels == ["Return", "Reward", "Success", "Reward"]
    assert len(drawn(tmp_path, metric="interventions").axes) == 1


def test_a_single_evaluation_is_drawn_as_dots(tmp_path, drawn):
    metrics = {"continuing/reward": 0.1}
    write_run(tmp_path / "many", TABLETOP, "naive", rising(3, 1), metrics=metrics)
    write_run(tmp_path / "few", TABLETOP, "fbrl", rising(2, 1), metrics=metrics)
    assert [line.get_marker() for line in drawn(tmp_path).axes[0].lines] == ["o"] * 4


def test_lines_beyond_ten_colours_are_dashed_and_long_names_are_wrapped(tmp_path, drawn):
    for number in range(11):
        options = {"discount": 0.9 + number / 1000, "learning_rate": 1e-3}
        write_run(tmp_path / str(10 + number), TABLETOP, "naive", rising(3, 3), metrics=METRICS, **options)
    write_run(tmp_path / "default", TABLETOP, "naive", rising(3, 3), metrics=METRICS)
    figure = drawn(tmp_path, size="column")
    lines = figure.axes[0].lines
    assert len({(line.get_color(), line.get_linestyle()) for line in lines}) == 12
    assert "C7" not in {line.get_color() for line in lines}, "matplotlib's grey looks like that of the released runs"
    assert texts(figure)[0] == "Naive RL (discount=0.9, learning_rate=0.001),\n3 seeds"
    assert figure.get_size_inches()[0] == 3.35
    names = [[f"{n}$^$" + 20 * " long" * (n < high) for n in range(12)] for high in (0, 6)]
    short, long = (drawn(tmp_path, size="page", names=own).axes[0].get_window_extent().height for own in names)
    assert long == pytest.approx(short, rel=0.05), "a legend with one high column takes no height of the panels"


def test_long_titles_are_wrapped(tmp_path, drawn):
    """With `published` each run has panels, whose titles ran over each other."""
    options = {"discount": 0.9, "learning_rate": 1e-3, "batch_size": 64, "timeout_bootstrap": True}
    for name, changed in {"a": options, "b": {}}.items():
        write_run(tmp_path / name, TABLETOP, "naive", rising(3, 3), metrics=METRICS, **changed)
    figure = drawn(tmp_path, size="page", published=True)
    left, right = (axis.title.get_window_extent() for axis in figure.axes[:2])
    assert 0 <= left.x0 < left.x1 < right.x0 < right.x1 <= figure.bbox.x1


def test_methods_keep_their_order_and_colours_and_unknown_tasks_their_names():
    assert method_order(["oracle", "mine", "naive", "also", "oracle"]) == ["naive", "oracle", "also", "mine"]
    assert colours(["oracle", "mine"])["oracle"] == COLOURS["oracle"]
    assert colours(["mine", "also"])["mine"] not in COLOURS.values()
    assert task_title("task_of_a_missing_package") == "task_of_a_missing_package"


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"names": ["one"]}, "1 labels for 2 runs; give one for each of: fbrl; naive"),
        ({"metric": "speed"}, "has no column 'speed'; it has"),
        ({"metric": FORWARD}, "fbrl has no evaluation at which every seed has a value of continuing/forward_success"),
        ({"smooth": 0}, "smooth must lie in"),
        ({"smooth": 2.5}, "smooth must be a whole number, not 2.5"),
        ({"size": "poster"}, "unknown size 'poster'; choose from screen, column, page"),
        ({"out": "x.bmp"}, r"\.png, \.pdf, \.svg"),
    ],
)
def test_what_cannot_be_drawn_is_refused(sweep, tmp_path, options, message):
    out = tmp_path / options.pop("out", "x.png")
    with pytest.raises(ValueError, match=message):
        plot_runs([sweep / TABLETOP], out, **options)


def test_the_command_says_that_it_replaces_a_picture(sweep, tmp_path):
    out = tmp_path / "a.png"
    code, printed, err = run("plot", sweep, "--out", out, "--size", "column", "--smooth", "10")
    assert (code, err) == (0, "")
    assert f"{out}\nMeans over seeds" in printed
    assert f"earl-jax: replaced {out} of 20" in run("plot", sweep / DOOR, "--out", out)[2]


def test_each_run_has_panels_over_the_released_seeds_of_the_paper(sweep, drawn):
    figure = drawn(sweep / TABLETOP, published=True)
    assert [axis.get_title().splitlines()[0] for axis in figure.axes] == ["FBRL", "FBRL", "Naive RL", "Naive RL"]
    for axis in figure.axes:
        published = [line for line in axis.lines if line.get_color() == RELEASED["color"]]
        assert [len(line.get_xdata()) for line in published] == [250] * 6, "five seeds and their mean"
        assert len(axis.lines) == 6 + 4
    assert texts(figure)[-1] == "Published, five seeds"
    assert "released seeds, where there are any" in caption(published=True)


def test_released_seeds_are_smoothed_over_as_many_steps_as_ours(tmp_path, drawn):
    write_run(tmp_path, TABLETOP, "fbrl", rising(3, 6), steps=range(30_000, 181_000, 30_000))
    figure = drawn(tmp_path, metric="deployed/success", published=True, smooth=2)
    [mean] = [
        line for line in figure.axes[0].lines if line.get_color() == RELEASED["color"] and line.get_alpha() is None
    ]
    released = released_curves(TABLETOP, "fbrl").metrics["deployed/success"].mean(axis=0)
    np.testing.assert_allclose(mean.get_ydata(), trailing(released, 6))


def test_a_task_without_released_seeds_has_none_in_its_legend(tmp_path, drawn):
    write_run(tmp_path, "dhand_lightbulb", "fbrl", rising(3, 3), metrics=METRICS)
    assert texts(drawn(tmp_path, metric="interventions", published=True)) == ["FBRL, 3 seeds"]


def test_further_files_have_the_same_picture_and_a_wrong_one_is_refused_before_any_is_written(sweep, tmp_path):
    first, second = tmp_path / "a.png", tmp_path / "b.svg"
    output = succeed("plot", sweep, "--out", first, second)
    assert output.startswith(f"{first}\n{second}\nMeans over seeds")
    assert "<svg" in second.read_text()
    code, _, err = run("plot", sweep, "--out", tmp_path / "c.png", tmp_path / "d.txt")
    assert (code, (tmp_path / "c.png").exists()) == (2, False), err
    code, _, err = run("plot", sweep, "--out")
    assert (code, err) == (2, "earl-jax: --out needs a picture to write\n")
