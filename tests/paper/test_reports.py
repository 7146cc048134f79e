"""Tables, curves and figures on runs written by hand, against numbers computed by hand. Figure 3 has its own tests."""

import math
import warnings

import numpy as np
import pytest
from matplotlib import colormaps
from matplotlib.colors import to_hex

from earl_jax import assets
from earl_jax.envs import PAPER_TASKS
from earl_jax.metrics.comparison import mean_interval
from earl_jax.paper import figure2, figure4
from earl_jax.paper.reproduce import ARTEFACTS
from earl_jax.paper.tradeoff import finding
from earl_jax.protocol import Continuing, Deployment
from earl_jax.report.pooling import read_methods
from earl_jax.report.published import INTERVAL_RULE
from earl_jax.report.scores import crossings_beside
from earl_jax.report.style import COLOURS
from tests.paper.written_runs import CHEETAH, FISH, LONG, RUNS, SCORES, SHORT, lifetimes, numbers, rewards, write_runs
from tests.report.run_files import DOOR, KITCHEN, TABLETOP, constant, count_pixels, read_csv


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """The files of every artefact: its csvs, text and picture."""
    root = tmp_path_factory.mktemp("reports")
    return {
        name: ARTEFACTS[name].write(write_runs(root / name, runs), root / name / "new" / "out")
        for name, runs in RUNS.items()
    }


TEXTS = {
    "figure5": [
        "| tabletop_organization | fbrl | 2 | 200,000 | 0.20M | 0.88M | - | 2.09M | 0.550 (0.035) | "
        "0.0040 (0.0000) | 0.0000 | 0.550 (0.035) | 0.000 |",
        "| - | - | - | - | 200.0 | 0.0000 | - | 200.0 | - |",
        "its band the 95 % interval of that mean, Wilson's for rates",
    ],
    "table1": [
        f"| method | {' | '.join(PAPER_TASKS)} |",
        "| naive | 0.500 (0.106) / 0.32 (0.17) / at 0.0008 % of the steps | - / 0.00 (0.00) / - |",
        "| -2700.00 (141.42) / -2705.21 (167.10) / at 0.0004 % of the steps |",
        "No run can be tested against the paper",
        "20 steps (published 2,500,000), 1 seed, reward_scale=1, shorter than published",
        "sawyer_peg (naive, fbrl, r3l, vaprl, oracle)",
        INTERVAL_RULE,
        "- sawyer_door: 0.94 of vaprl is one evaluation",
    ],
    "figure2": [
        "| 0.762 | 0.762 | cannot tell (detectable 81.6) | restored | agrees |",
        "| cheetah_run | 100,000 | 395.0 [341.3, 448.7] | ",
        "- cheetah_run, with the biased update: 2,000; 5,000; 10,000; 20,000; 200,000",
    ],
    "tradeoff": [
        "| naive | epsilon | 5 to 300 | 0.000 to 0.420 | 0.935 | 0.00",
        " | helps |",
        "| fbrl | budget | 10 | 2 | 20 | 15.0 (0.0) | 0.200 (0.071) | 0.200 (0.071) | 1.00 |",
        "| naive | epsilon | 5 to 6 | 0.100 to 0.200 | 1.000 | 1.000 | 1.000 | cannot tell: fewer than four seeds |",
    ],
}
ABSENT = {"table1": ["- minitaur_pen", "Two more claims"], "tradeoff": ["fbrl | epsilon | 5"], "figure5": ["\n\n\n"]}


def test_a_report_replaces_an_older_one_by_whole_files(tmp_path):
    """A reader of an older file keeps it: a new one takes its place."""
    report = figure4.report_of(seed_rows("fbrl", [1.0], [0.5]))
    before, after = ([path.stat().st_ino for path in report.write("figure4", tmp_path)] for _ in range(2))
    assert [old == new for old, new in zip(before, after, strict=True)] == [False] * 4


@pytest.mark.parametrize("name", TEXTS)
def test_the_text_has_our_numbers_beside_the_published_ones(files, name):
    text = files[name][-2].read_text()
    assert [part for part in TEXTS[name] if part not in text] == []
    assert [part for part in ABSENT.get(name, ()) if part in text] == []


SHORTEST, LONGEST = (to_hex(colour) for colour in colormaps["viridis"]([0.0, 0.92]))
PICTURES = {
    "figure5": (["fbrl"], ["r3l"]),
    "table1": (["naive", "oracle"], ["vaprl"]),
    "figure2": (["#D55E00", "#0072B2", SHORTEST, LONGEST], []),
    "tradeoff": (["naive", "fbrl"], ["r3l"]),
}


@pytest.mark.parametrize("name", PICTURES)
def test_the_picture_shows_what_was_run(files, name):
    shown, absent = ([count_pixels(files[name][-1], COLOURS.get(of, of)) for of in parts] for parts in PICTURES[name])
    assert min(shown) > 20
    assert sum(absent) == 0


def test_curves_hold_means_and_intervals(files):
    rows = {(row["env"], row["metric"], int(row["step"])): row for row in read_csv(files["figure5"][0])}
    assert numbers(rows[TABLETOP, "deployed/success", 200_000], "mean", "seeds") == pytest.approx([0.8, 2])
    assert rows[TABLETOP, "deployed/success", 200_000]["low"] == "nan", "two seeds have no interval"
    assert float(rows[TABLETOP, "deployed/success (trailing 10)", 200_000]["mean"]) == pytest.approx(0.55)
    assert float(rows[KITCHEN, "deployed/return", 40]["mean"]) == 300


def test_published_crossings_are_drawn_only_beside_the_papers_setting(tmp_path):
    kinds = {"layer_norm": True}, {"setting": Deployment(intervention_chance=0.01)}
    runs = [(TABLETOP, "fbrl", SCORES, rewards(0.004, **options)) for options in kinds]
    marks = [crossings_beside(read_methods([path])[0]) for path in write_runs(tmp_path, runs)]
    assert marks == [{0.5: 880_000, 0.9: 2_090_000}, {}]


def test_the_published_score_in_figure_5_is_over_the_steps_of_ours(tmp_path):
    """Our two evaluations are 1M steps apart; the released ones of the last tenth are 200,000."""
    run = (TABLETOP, "fbrl", SCORES, rewards(steps=(1_000_000, 2_000_000)))
    released = assets.released_runs(TABLETOP, "fbrl")["deployed"][:, 98:199].mean()
    text = ARTEFACTS["figure5"].report(write_runs(tmp_path, [run])).parts["scores"]
    assert text.endswith(f"| 0.550 (0.035) | {released:.3f} |")


@pytest.mark.parametrize("options", [{}, {"batch_size": 64, "discount": 0.95, "learning_rate": 1e-3}])
def test_the_legend_of_figure_5_fits_if_names_have_options(tmp_path, options):
    variants = [(algo, changed) for algo in ("naive", "fbrl") for changed in ({"reward_scale": 1.0, **options}, {})]
    runs = [(TABLETOP, algo, SCORES, rewards(0.004, **changed)) for algo, changed in variants]
    figure = ARTEFACTS["figure5"].report(write_runs(tmp_path, runs)).figure
    figure.draw_without_rendering()
    legend = figure.legends[0].get_window_extent()
    assert 0 <= legend.x0 < legend.x1 <= figure.bbox.x1


def test_runs_of_a_task_by_success_and_by_return_have_columns_of_their_own_in_figure_5(tmp_path):
    kinds = [rewards(0.004, env_options={"reward_type": reward}) for reward in ("sparse", "dense")]
    folders = write_runs(tmp_path, [(TABLETOP, "fbrl", SCORES, kind) for kind in kinds])
    figure = ARTEFACTS["figure5"].report(folders).figure
    assert [axis.get_ylabel().partition(" ")[0] for axis in figure.axes[:2]] == ["Success", "Return"]


def test_each_point_of_figure_2_has_the_final_returns_of_its_lanes(files):
    rows = {(row["env"], row["timeout_bootstrap"], row["train_horizon"]): row for row in read_csv(files["figure2"][0])}
    assert len(rows) == 6
    assert numbers(rows[CHEETAH, "True", "100000"], "return", "seeds") == [110, 3]
    assert [float(rows[FISH, update, "1000"]["return"]) for update in ("True", "False")] == [8.5, 7]
    curves = read_csv(files["figure2"][1])
    assert len(curves) == 6 * 2
    curve = [numbers(row, "step", "return") for row in curves if row["env"] == CHEETAH][:2]
    assert curve == [[10, 510], [20, 510]]


@pytest.mark.parametrize(
    ("learner", "expected"),
    [
        ({"fixed_temperature": True, "reward_scale": 0.1}, "temperature fixed at 1, reward scale 0.1"),
        ({"learner": "td3"}, "learner td3, reward scale 10"),
    ],
)
def test_figure_2_says_how_the_target_changes_and_what_the_learner_is(tmp_path, learner, expected):
    tied = {"setting": Continuing(goal_change=2_000), "env_options": {"train_horizon": 2_000}}
    runs = [(FISH, "naive", constant(1.0), {**tied, **learner})]
    report = ARTEFACTS["figure2"].report(write_runs(tmp_path, runs))
    assert report.parts["runs"] == f"- fish_swim: 20 steps, the target stays between resets, {expected}"
    assert ("The learner is SAC" in report.text("figure2")) == ("learner" not in learner)


@pytest.mark.parametrize(
    ("finding", "effect", "published", "verdict"),
    [
        ("cannot tell", "above", "degrades", "cannot tell"),
        ("below", "above", "degrades", "differs"),
        ("cannot tell", "cannot tell", "restored", "cannot tell"),
        ("above", "above", "restored", "differs"),
        ("-", "above", "restored", "-"),
        ("above", "-", None, "-"),
    ],
)
def test_verdicts_of_figure_2_need_a_clear_difference(finding, effect, published, verdict):
    assert figure2.verdict(finding, effect, published) == verdict


AGES = [{}, {"steps": (50, 100), "setting": Deployment(intervention_chance=0.1)}]
DIFFERENT = [{"reward_scale": 1.0}, {"reward_scale": 2.0}]
REFUSED = {
    "oracle": ("figure2", FISH, "oracle", [{}], "runs of naive, not of oracle"),
    "never": ("figure2", FISH, "naive", [{"env_options": {"train_horizon": 0}}], "fish_swim has none: train_horizon=0"),
    "figure2": ("figure2", FISH, "naive", DIFFERENT, r"H_T 100,000, with the biased update, differ in other options"),
    "figure4": ("figure4", TABLETOP, "fbrl", DIFFERENT, "runs of fbrl differ in task or options"),
    "tradeoff": ("tradeoff", TABLETOP, "naive", DIFFERENT, f"naive on {TABLETOP} with epsilon 0 differ in other"),
    "ages": ("tradeoff", TABLETOP, "naive", AGES, f"naive on {TABLETOP} has no evaluation in the first 20 steps"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_runs_that_do_not_belong_to_a_figure_are_refused(tmp_path, case):
    name, env, algo, options, message = REFUSED[case]
    runs = [(env, algo, [[0.0, 1.0]], {"metrics": {"interventions": 1}, **own}) for own in options]
    with pytest.raises(ValueError, match=message):
        ARTEFACTS[name].report(write_runs(tmp_path, runs))


def test_points_of_figure_2_are_tested_over_the_same_steps_and_not_without_any(tmp_path):
    """The run with a longer horizon improves after the shorter one has ended."""
    later, seeds = [[0.0] * 10 + [600.0] * 10] * 3, np.arange(3)[:, None]
    for steps, tested in ((range(10, 110, 10), "| 500.0 ["), ((5,), "| - | - | - | - | restored | - |")):
        ages = [(SHORT, np.full((3, len(steps)), 500.0), {"steps": steps}), (LONG, later, {})]
        runs = [(CHEETAH, "naive", scores + seeds, {"env_options": task, **own}) for task, scores, own in ages]
        assert tested in ARTEFACTS["figure2"].report(write_runs(tmp_path / str(len(steps)), runs)).parts["findings"]


def test_a_method_of_figure_2_with_one_horizon_is_not_tested(tmp_path):
    runs = write_runs(tmp_path, [(CHEETAH, "naive", SCORES, {"env_options": SHORT})])
    assert "cheetah_run" not in ARTEFACTS["figure2"].report(runs).parts["findings"]


def test_a_line_of_the_trade_off_is_scored_over_the_same_steps(tmp_path):
    """Both are scored over steps 60 to 100, the last five evaluations of the rarer ones."""
    ages = [(np.arange(10, 110, 10), 0.0), (np.arange(2, 102, 2), 0.01)]
    runs = [(TABLETOP, "naive", [at / 100], {**lifetimes(5, chance), "steps": at.tolist()}) for at, chance in ages]
    rows = ARTEFACTS["tradeoff"].report(write_runs(tmp_path, runs)).tables[""]
    assert [row["final"] for row in rows] == pytest.approx([0.8, 0.8])


@pytest.mark.parametrize(("values", "p"), [([1, 2, 3], 2 / 6), ([1, 2, 3, 4], 2 / 24), ([1, 1, 2, 2], 2 / 6)])
def test_the_trade_off_correlates_scores_with_assigned_values_by_permutations(values, p):
    """What a run spends follows from its policy, and the t approximation gives p = 0 for any three points in order."""
    pairs = enumerate(values)
    rows = [{"env": DOOR, "value": n, "final": n / 10, "interventions": -place} for place, n in pairs]
    tested = finding(rows)
    assert (tested["difference"], tested["p"]) == pytest.approx((1.0, p))
    assert math.isnan(finding([{**row, "final": math.nan} for row in rows])["p"])
    rounded = [{**row, "final": row["final"] + 1e-8 * place} for place, row in enumerate(rows)]
    assert (finding(rounded)["difference"], finding(rounded)["p"]) == pytest.approx((1.0, p)), "ties stay ties"


def test_the_trade_off_of_a_dense_reward_is_drawn_as_returns(tmp_path):
    """Their mean has Student's interval; Wilson's, which is for rates, is a warning and nan."""
    dense = {"env_options": {"reward_type": "dense"}}
    scores = constant(-100.0, -200.0, -150.0), constant(-50.0, -60.0, -80.0)
    runs = [(TABLETOP, "naive", own, {**lifetimes(5, n / 100), **dense}) for n, own in enumerate(scores)]
    with warnings.catch_warnings(action="error"):
        figure = ARTEFACTS["tradeoff"].report(write_runs(tmp_path, runs)).figure
    assert [axis.get_ylabel() for axis in figure.axes] == ["Return of the deployed policy", "Mean return over training"]
    [interval, _] = figure.axes[0].containers[0].lines[2][0].get_segments()
    assert interval[:, 1] == pytest.approx(mean_interval(scores[0][:, 0])[1:])


DROPS = {
    "fbrl": ([1.0, 1.0], [0.5, 0.6], "larger"),
    "r3l": ([0.0, 0.0], [0.0, 0.1], "-"),
    "vaprl": ([1.0, 1.0], [1.0, 1.0], "smaller"),
    "oracle": ([1.0, 0.8], [0.5, 0.6], "within"),
}
"""Success from both kinds of starts and the verdict by method, in the paper's order."""


def seed_rows(algo, *successes):
    pairs = enumerate(zip(*successes, strict=True))
    return [{"algo": algo, "seed": seed, "success_initial": a, "success_uniform": b} for seed, (a, b) in pairs]


def test_drops_of_figure_4_are_compared_with_the_published_ones(tmp_path):
    rows = [row for algo in reversed(DROPS) for row in seed_rows(algo, *DROPS[algo][:2])]
    csv_file, seeds_file, text_file, picture = figure4.report_of(rows).write("figure4", tmp_path)
    methods = {row["algo"]: row for row in read_csv(csv_file)}
    assert list(methods) == list(DROPS)
    assert [row["verdict"] for row in methods.values()] == [verdict for *_, verdict in DROPS.values()]
    oracle = numbers(methods["oracle"], "initial", "uniform", "drop", "drop_low", "drop_high", "published_drop")
    assert oracle == pytest.approx([0.9, 0.55, 7 / 18, 0.25, 0.5, 0.374])
    assert [{name: str(value) for name, value in row.items()} for row in rows] == read_csv(seeds_file)
    line = "| oracle | 2 | 0.900 | 0.550 | 38.9 [25.0, 50.0] | 37.4 % | within |"
    assert line in text_file.read_text()
    assert count_pixels(picture, COLOURS["fbrl"]) > 1000


@pytest.mark.parametrize(("successes", "caps"), [([0.9, 0.8, 0.6], True), ([0.9, 0.8], False), ([0.9], False)])
def test_figure_4_draws_no_interval_of_fewer_than_three_seeds(successes, caps):
    """A bar of two seeds used to have the caps of an interval without width."""
    report = figure4.report_of(seed_rows("fbrl", successes, successes))
    assert report.tables[""][0]["verdict"] == ("smaller" if len(successes) > 1 else "-")
    axis = report.figure.axes[0]
    assert axis.lines
    assert all(math.isfinite(value) == caps for line in axis.lines for value in line.get_ydata())
