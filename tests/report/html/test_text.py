"""Numbers and option values as a page shows them."""

import datetime

import numpy as np

from earl_jax.report.html.text import date_text, number_text, option_text, steps_text


def test_numbers_have_separators_and_a_true_minus_sign():
    assert (number_text(1234.56, 1), number_text(-0.5, 2), number_text(None, 3)) == ("1,234.6", "−0.50", "–")


def test_steps_are_short():
    texts = [steps_text(steps) for steps in (None, 500, 20_000, 2_500_000)]
    assert texts == ["–", "500", "20k", "2.5M"]


def test_option_values_are_json_and_strings_have_no_quotes():
    texts = [option_text(value) for value in ("bf16", (8, 8), True, np.float32(0.5))]
    assert texts == ["bf16", "[8, 8]", "true", "0.5"]


def test_dates_name_the_month():
    assert date_text(datetime.datetime(2026, 5, 3)) == "3 May 2026"
