"""J_D, D(A) and C(A) against sums by hand, and the steps at which a curve reaches a level."""

import math

import numpy as np
import pytest

from earl_jax.errors import InputError
from earl_jax.metrics.comparison import permutation
from earl_jax.metrics.crossings import crossing, trailing_mean
from earl_jax.metrics.scores import Score, Window, as_decimals, final_scores, lifetime_scores, regret

STEPS, SCORES = np.array([10, 30]), np.array([[1.0, 0.5], [0.0, 0.3]])
MILLION = np.arange(10_000, 1_000_001, 10_000)


def test_single_precision_keeps_its_digits_and_loses_its_rounding_so_that_equal_differences_tie():
    scores, others = np.float32([0.8, 0.85, 0.9, 0.95, 1.0]), np.float32([0.7, 0.8, 0.9, 0.95, 1.0])
    assert as_decimals(scores).tolist() == [0.8, 0.85, 0.9, 0.95, 1.0]
    values = np.float32([-0.0, 1e-30, 1 / 3, 3.5e11, np.nan, np.inf])
    np.testing.assert_array_equal(as_decimals(values).astype(np.float32), values)
    assert as_decimals(np.int32([7])).dtype == np.int32
    assert permutation(as_decimals(scores), as_decimals(others)).p == permutation(scores, others).p == 194 / 252


def test_a_lifetime_has_three_scores_and_its_area_weights_an_evaluation_by_the_steps_before_it():
    metrics = {"deployed/success": SCORES, "continuing/reward": np.array([[0.1, 0.2], [0.0, 0.4]])}
    scores = lifetime_scores(STEPS, metrics, "deployed/success")
    assert scores.final.tolist() == [0.5, 0.3]
    assert scores.deployed == pytest.approx([2 / 3, 0.2])
    assert scores.continuing.tolist() == [0.2, 0.4]
    with pytest.raises(ValueError, match="unknown metric 'success'"):
        lifetime_scores(STEPS, metrics, "success")
    with pytest.raises(ValueError, match="unknown metric 'continuing/reward'; choose from deployed/success"):
        lifetime_scores(STEPS, {"deployed/success": metrics["deployed/success"]}, "deployed/success")
    with pytest.raises(ValueError, match=r"steps \(1,\) and scores \(2, 2\) do not belong to the same evaluations"):
        lifetime_scores(STEPS[:1], metrics, "deployed/success")


@pytest.mark.parametrize(
    ("end", "every", "window", "count"),
    [
        (2_500_000, 10_000, Window(), 25),
        (170_000, 2_500, Window(), 7),
        (100_000, 10_000, Window(), 5),
        (30, 10, Window(), 3),
        (100_000, 10_000, Window(last=1), 1),
        (100_000, 10_000, Window(steps=30_000), 3),
        (100_000, 10_000, Window(last=99), 10),
    ],
)
def test_a_seed_is_scored_over_the_last_tenth_and_over_five_evaluations_at_least(end, every, window, count):
    steps = np.arange(every, end + 1, every)
    curves = np.random.default_rng(0).random((2, len(steps)))
    assert window.count(steps) == count
    np.testing.assert_allclose(final_scores(steps, curves, window), curves[:, -count:].mean(axis=1))


def test_a_score_says_what_it_is_a_mean_of():
    curves = {"deployed/success": np.tile([[0.2], [0.4], [0.6]], 60)}
    score = Score.of(MILLION[:60], curves, "deployed/success", "deployed/success")
    text = "deployed/success 0.400 [0.098, 0.803], mean of 3 seeds over 6 evaluations, steps 550,000 to 600,000"
    assert str(score) == text
    last = Score.of(MILLION[:60], {"x": np.array([[3.0] * 60])}, "x", "x", Window(last=1))
    assert str(last) == "x 3.000, mean of 1 seed over the evaluation at step 600,000"
    with pytest.raises(ValueError, match="no evaluation yet"):
        Score.of(MILLION[:0], {"x": np.empty((1, 0))}, "x", "x")


def test_a_reward_per_step_has_the_interval_of_a_rate_only_where_rewards_are_0_and_1_and_seeds_differ():
    rewards = {"continuing/reward": np.tile([[0.0], [0.1], [0.5]], 5)}
    steps, metric = MILLION[:5], "continuing/reward"
    sparse, dense = (Score.of(steps, rewards, metric, f"deployed/{kind}") for kind in ("success", "return"))
    assert sparse.low > 0 > dense.low
    equal = Score.of(steps, {metric: np.full((3, 5), 0.1)}, metric, "deployed/success")
    assert equal.mean == pytest.approx(0.1)
    assert math.isnan(equal.low)


def test_a_window_counts_evaluations_or_steps():
    with pytest.raises(ValueError, match="give one of them"):
        Window(1, 1)
    with pytest.raises(ValueError, match=r"last must lie in \[1, "):
        Window(last=0)
    with pytest.raises(ValueError, match="window must be a whole number"):
        Window(steps=1.5)
    with pytest.raises(InputError, match=r"must be an .*scores\.Window, such as Window\(last=5\), not 'x'"):
        Score.of(STEPS, {"x": SCORES}, "x", "x", "x")


def test_regret_is_the_sum_of_gaps_to_the_optimum():
    gaps = np.repeat(1.0 - SCORES, [10, 20], axis=1)
    np.testing.assert_allclose(regret(STEPS, SCORES, 1.0), gaps.sum(axis=1))
    for steps in (STEPS[::-1], STEPS[:1].repeat(len(STEPS)), STEPS[:0]):
        with pytest.raises(InputError, match="steps must be at least one evaluation in ascending order"):
            regret(steps, SCORES[:, : len(steps)], 1.0)


def test_the_window_of_a_trailing_mean_is_measured_in_steps():
    ramp = np.linspace(0.01, 1.0, 100)
    means = trailing_mean(MILLION, ramp)
    assert np.isnan(means[:9]).all()
    assert means[9] == pytest.approx(ramp[:10].mean())
    assert means[-1] == pytest.approx(ramp[-10:].mean())
    np.testing.assert_allclose(trailing_mean(MILLION[1::2], ramp[1::2])[-1], ramp[-9::2].mean())


def test_a_mean_without_a_score_or_that_rounds_changes_no_other_crossing():
    level = np.where(MILLION > 100_000, 0.3, 0.0)
    assert crossing(MILLION, np.tile(level, (5, 1)), 0.3).value == 200_000
    level[2] = np.nan
    assert np.isnan(trailing_mean(MILLION, level)[:13]).tolist() == [True] * 12 + [False]


def test_a_crossing_is_that_of_the_mean_curve_and_nan_where_none_is():
    scores = np.stack([MILLION >= 300_000, MILLION >= 500_000]).astype(float)
    assert crossing(MILLION, scores, 0.5).value == 390_000
    assert crossing(MILLION, scores, 0.9).value == 570_000
    assert math.isnan(crossing(MILLION, scores, 1.1).value)
    single = crossing(MILLION, scores[:1], 0.5)
    assert (single.value, math.isnan(single.low), math.isnan(single.high)) == (340_000, True, True)
