"""Figure 2 on small numbers whose findings are known."""

import pytest
from matplotlib import colormaps

from earl_jax.paper.figure2 import FIGURE2, verdict
from earl_jax.protocol import Continuing
from tests.report.run_files import constant, count_pixels, read_csv, write_run

RETURNS = {
    (True, 1_000): [500.0, 520.0],
    (True, 100_000): [100.0, 120.0],
    (False, 1_000): [500.0, 500.0],
    (False, 100_000): [480.0, 530.0],
}
"""Final returns on cheetah_run by `timeout_bootstrap` and H_T."""


def horizon_options(horizon):
    return {} if horizon == 100_000 else {"train_horizon": horizon}


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """The files of figure 2: four runs of cheetah, and one of fish whose lanes differ in their update."""
    root = tmp_path_factory.mktemp("figure2")
    folders = [
        write_run(
            root / f"{update}{horizon}",
            "cheetah_run",
            "naive",
            constant(*scores),
            env_options=horizon_options(horizon),
            timeout_bootstrap=update,
        )
        for (update, horizon), scores in RETURNS.items()
    ]
    mixed = {"env_options": horizon_options(1_000), "timeout_bootstrap": [False, True, True]}
    folders.append(write_run(root / "fish", "fish_swim", "naive", constant(7.0, 8.0, 9.0), **mixed))
    return FIGURE2.write(folders, root / "out")


def test_each_point_has_the_final_returns_of_its_lanes(files):
    rows = {(row["env"], row["timeout_bootstrap"], row["train_horizon"]): row for row in read_csv(files[0])}
    assert len(rows) == 6
    point = rows["cheetah_run", "True", "100000"]
    assert [float(point[name]) for name in ("return", "low", "high", "seeds")] == [110, 100, 120, 2]
    assert float(rows["fish_swim", "True", "1000"]["return"]) == 8.5
    assert float(rows["fish_swim", "False", "1000"]["return"]) == 7


def test_the_text_reports_degradation_and_what_the_biased_update_restores(files):
    text = files[2].read_text()
    assert "biased update | 1,000 and 100,000 | 400.0 [380.0, 420.0] | degrades | degrades | agrees |" in text
    assert "| -5.0 [-30.0, 20.0] | no clear difference | restored | agrees |" in text
    assert "| cheetah_run | 100,000 | 395.0 [360.0, 430.0] | helps |" in text
    assert "- cheetah_run, with the biased update: 2,000; 5,000; 10,000; 20,000; 200,000" in text


def test_the_picture_shows_the_curves_of_training_and_both_updates(files):
    assert min(count_pixels(files[3], colour) for colour in ("#D55E00", "#0072B2")) > 100
    rows = read_csv(files[1])
    curve = [(row["step"], row["return"], row["low"], row["high"]) for row in rows if row["env"] == "cheetah_run"][:2]
    assert curve == [("10", "510.0", "500.0", "520.0"), ("20", "510.0", "500.0", "520.0")]
    assert len(rows) == 6 * 2
    shortest, longest = colormaps["viridis"]([0.0, 0.92])
    assert min(count_pixels(files[3], colour[:3]) for colour in (shortest, longest)) > 200


def test_the_text_says_how_the_target_changes_and_what_the_learner_is(files, tmp_path):
    text = files[2].read_text()
    assert "- cheetah_run: 20 steps, one goal, temperature learnt from 1, reward scale 10" in text
    assert "- fish_swim: 20 steps, another target every 1,000 steps" in text
    tied = write_run(
        tmp_path / "tied",
        "fish_swim",
        "naive",
        constant(1.0),
        setting=Continuing(goal_change=2_000),
        env_options={"train_horizon": 2_000},
        fixed_temperature=True,
        reward_scale=0.1,
    )
    text = FIGURE2.write([tied], tmp_path / "out")[2].read_text()
    assert "the target stays between resets, temperature fixed at 1, reward scale 0.1" in text


def test_verdicts_need_a_clear_difference():
    assert verdict("no clear difference", "helps", "degrades") == "inconclusive"
    assert verdict("improves", "helps", "degrades") == "differs"
    assert verdict("no clear difference", "no clear difference", "restored") == "inconclusive"
    assert verdict("degrades", "helps", "restored") == "differs"
    assert verdict("-", "helps", "restored") == verdict("degrades", "-", None) == "-"


def test_other_methods_are_refused(tmp_path):
    oracle = write_run(tmp_path / "a", "fish_swim", "oracle", constant(1.0))
    with pytest.raises(ValueError, match="runs of naive, not of oracle"):
        FIGURE2.write([oracle], tmp_path / "out")


def test_two_runs_for_one_point_are_refused(tmp_path):
    runs = [
        write_run(tmp_path / str(scale), "fish_swim", "naive", constant(1.0), reward_scale=scale)
        for scale in (1.0, 2.0)
    ]
    with pytest.raises(ValueError, match=r"H_T 100,000, with the biased update, differ in other options"):
        FIGURE2.write(runs, tmp_path / "out")
