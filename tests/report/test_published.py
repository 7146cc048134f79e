"""Published scores, their intervals, against numbers computed by hand."""

import math

import pytest

from earl_jax.metrics.statistics import Estimate
from earl_jax.report import published
from earl_jax.report.published import PublishedScore


def test_a_published_interval_is_students_and_half_a_printed_digit():
    """t(4) is 2.7764, and the paper's errors of five seeds divide by n."""
    reach = 2.7764 * (5 / 4) ** 0.5
    naive = 0.17 * reach + 0.005
    assert PublishedScore("0.32", "0.17").interval == pytest.approx((0.32 - naive, 0.32 + naive), abs=1e-4)
    exact = 0.005 * reach + 0.005
    assert PublishedScore("1.00", "0.00").interval == pytest.approx((1 - exact, 1 + exact), abs=1e-4)
    assert PublishedScore("<0.001", "-").interval == (0, 0.001)
    assert PublishedScore("-", "-").interval is None


def test_a_published_score_as_text_and_number():
    assert (PublishedScore("0.32", "0.17").text, PublishedScore("<0.001", "-").text) == ("0.32 (0.17)", "<0.001")
    assert (PublishedScore("0.32", "0.17").value, PublishedScore("<0.001", "-").value) == (0.32, 0.001)


def test_a_difference_is_clear_only_if_the_whole_interval_lies_on_one_side():
    estimates = [Estimate(4, 3, 5), Estimate(-1, -2, -0.1), Estimate(0, -1, 1), Estimate(1, math.nan, math.nan)]
    words = [published.word_by_sign(estimate, "more", "less", "unclear") for estimate in estimates]
    assert words == ["more", "less", "unclear", "unclear"]


def test_published_numbers_are_looked_up_by_task_and_method():
    assert published.published_score("table1", "sawyer_door", "r3l") == ("0.54", "0.18")
    assert published.published_score("table1", "sawyer_door", "mine") is None
    assert published.published_crossings("tabletop_organization", "naive") == {0.5: 1_350_000}
    assert published.published_crossings("tabletop_organization", "mine") == {}
    assert published.published_steps("sawyer_door") == (4_000_000, 4_000_000)
    assert published.published_steps("cheetah_run") is None
    assert "one lucky evaluation" in published.published_fault("table1", "sawyer_door")
    assert published.published_fault("table1", "tabletop_organization") is None
