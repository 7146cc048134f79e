"""Published scores, their intervals and samples, against numbers computed by hand."""

from unittest.mock import Mock

import numpy as np
import pytest
from scipy import stats

from earl_jax import assets, make, make_algo
from earl_jax.report.published import PublishedScore, chosen_words, released_curves, share_text
from tests.conftest import make_config

T4 = 2.7764
"""The 97.5 % quantile of Student's distribution with four degrees of freedom."""
CONVERTED = (5 / 4) ** 0.5
"""The paper's errors of five seeds divide by n."""


@pytest.mark.parametrize(
    ("mean", "stderr", "error", "interval"),
    [
        ("0.32", "0.17", 0.17, (0.0522, 0.7899)),
        ("1.00", "0.00", 0.005, (5 / (5 + 3.8415) - 0.005, 1.0)),
        ("-9.0", "1.0", 1.0, (-9 - T4 * CONVERTED - 0.05, -9 + T4 * CONVERTED + 0.05)),
    ],
)
def test_a_published_score_is_a_sample_with_an_interval_half_a_printed_digit_wider(mean, stderr, error, interval):
    score = PublishedScore(mean, stderr)
    assert (score.value, score.text) == (float(mean), f"{mean} ({stderr})")
    assert score.sample == pytest.approx((float(mean), error * CONVERTED, 5))
    assert score.interval == pytest.approx(interval, abs=1e-4)


def test_released_success_is_a_share_of_ten_episodes_without_the_rounding_of_single_precision():
    curves = released_curves("tabletop_organization", "naive")
    assert set(np.unique(curves.metrics["deployed/success"])) == {number / 10 for number in range(11)}


def test_a_share_of_the_steps_has_two_digits_and_no_exponent():
    assert [share_text(steps, 1_000_000) for steps in (48, 120_000, 999_000)] == ["0.0048 %", "12 %", "99 %"]


def test_a_score_without_an_error_is_no_sample():
    below = PublishedScore("<0.001", "-")
    assert (below.value, below.text, below.interval, below.sample) == (0.001, "<0.001", (0, 0.001), None)


@pytest.mark.parametrize(("env", "horizon"), [("franka_kitchen", 100_000), ("sawyer_door", 200_000)])
@pytest.mark.parametrize("algo", ["naive", "fbrl"])
def test_the_released_lives_change_most_after_the_steps_at_which_their_world_is_put_back(env, horizon, algo):
    """The rewards of two neighbouring intervals differ most where an intervention lies between them."""
    runs = assets.released_runs(env, algo)
    steps = runs["steps"]
    rates = np.diff(runs["continuing"] * steps)
    ranks = stats.rankdata(np.abs(np.diff(rates)), axis=1).mean(axis=0)
    phases = steps[1:-1] % horizon
    assert max(np.unique(phases), key=lambda phase: ranks[phases == phase].mean()) == 0


@pytest.mark.parametrize(
    ("algo", "steps", "marked"),
    [("naive", 1_000_000, False), ("naive", 1_000_040, True), ("fbrl", 2_000_000, False), ("fbrl", 2_000_040, True)],
)
def test_the_default_replay_is_marked_in_runs_in_which_it_evicts(algo, steps, marked):
    config = make_config(make("tabletop_organization"), make_algo(algo), steps=steps)
    assert ("replay" in chosen_words(Mock(config=config)).split(", ")) == marked
