"""The trade-off on runs written by hand, against numbers computed by hand."""

import pytest

from earl_jax.paper.tradeoff import TRADEOFF
from earl_jax.protocol import Deployment
from earl_jax.report.style import COLOURS
from tests.report.run_files import TABLETOP, count_pixels, read_csv, write_run


def lifetimes(path, algo, scores, interventions, chance=0.0, budget=None, asked=0, enforced=0, over=0):
    """Write a run with the scores [N, E] and the counts at its end."""
    helped = {"help/asked": asked, "help/enforced": enforced, "help/over": over}
    metrics = {"continuing/reward": 0.0, "interventions": interventions, **(helped if budget else {})}
    setting = Deployment(intervention_chance=chance, budget=budget)
    return write_run(path, TABLETOP, algo, scores, setting=setting, metrics=metrics)


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """The files of two values of epsilon and two budgets of naive RL, and of one of FBRL."""
    root = tmp_path_factory.mktemp("tradeoff")
    none, low = [[0.0, 0.0, 1.0]] * 5, [[0.1, 0.1], [0.3, 0.3]]
    late = [[0.0, 1.0], [0.0, 0.8], [0.0, 0.6], [0.0, 0.8], [0.0, 1.0]]
    folders = [
        lifetimes(root / "a", "naive", late, 300, chance=0.01),
        lifetimes(root / "b", "naive", none, 5),
        lifetimes(root / "c", "naive", low, 5, budget=10.0, asked=6, enforced=4, over=[[0, 1], [0, 0]]),
        lifetimes(root / "d", "naive", [[0.0, 0.0]] * 2, 5, budget=100.0, asked=1),
        lifetimes(root / "e", "fbrl", low, 5, chance=0.01),
    ]
    return TRADEOFF.write(folders, root / "out")


def test_each_seed_has_its_scores_and_all_interventions(files):
    rows = {(row["algo"], row["kind"], row["value"], row["lane"]): row for row in read_csv(files[0])}
    assert len(rows) == 16
    late = rows["naive", "epsilon", "0.01", "1"]
    assert [float(late[name]) for name in ("interventions", "final", "deployed_area")] == pytest.approx([300, 0.4, 0.4])
    helped = rows["naive", "budget", "10.0", "0"]
    assert [float(helped[name]) for name in ("interventions", "final", "ended")] == pytest.approx([15, 0.1, 1])


def test_runs_of_a_line_are_compared_at_the_last_step_that_all_have(files):
    rows = [row for row in read_csv(files[0]) if (row["algo"], row["kind"]) == ("naive", "epsilon")]
    assert len({row["steps"] for row in rows}) == 1
    assert {row["final"] for row in rows if row["value"] == "0.0"} == {"0.0"}  # its third evaluation comes later


def test_the_text_says_whether_more_interventions_help(files):
    text = files[1].read_text()
    assert "| naive | epsilon | 5 to 300 | 0.000 to 0.420 | 0.935 | <0.001 | <0.001 | help |" in text
    assert "| naive | budget | 6 to 15 | 0.000 to 0.200 | 0.943 | 0.057 | 0.057 | cannot tell |" in text
    assert "| naive | budget | 10 | 2 | 20 | 15.0 (0.0) | 0.200 (0.071) | 0.200 (0.071) | 0.50 |" in text
    assert "fbrl | epsilon | 5" not in text


def test_the_picture_shows_both_methods(files):
    assert count_pixels(files[2], COLOURS["naive"]) > 100
    assert count_pixels(files[2], COLOURS["fbrl"]) > 20


def test_two_runs_for_one_point_are_refused(tmp_path):
    runs = [
        write_run(
            tmp_path / str(scale), TABLETOP, "naive", [[0.0, 1.0]], metrics={"interventions": 1}, reward_scale=scale
        )
        for scale in (1.0, 2.0)
    ]
    with pytest.raises(ValueError, match=r"naive on tabletop_organization with epsilon 0 differ in other options"):
        TRADEOFF.write(runs, tmp_path / "out")
