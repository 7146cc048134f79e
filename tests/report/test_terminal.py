"""Tables for a terminal: aligned columns where they fit, else a block for each row."""

import pytest

from earl_jax.report.terminal import shown_table, wrapped

HEADER = ("task", "score [95 %]", "published")
LINES = [["door", "0.5 [0.4, 0.6]", "-"], ["tabletop_organization", 1, "-"]]


def test_a_table_that_fits_is_aligned_and_has_no_empty_column():
    assert shown_table(HEADER, LINES, 80).splitlines() == [
        "task                   score [95 %]",
        "door                   0.5 [0.4, 0.6]",
        "tabletop_organization  1",
    ]


def test_a_table_without_a_width_is_markdown():
    assert shown_table(HEADER, LINES, None).splitlines()[2] == "| door | 0.5 [0.4, 0.6] | - |"


@pytest.mark.parametrize("width", [24, 36])
def test_a_table_that_is_too_wide_has_a_block_for_each_row(width):
    text = shown_table(HEADER, LINES, width)
    assert len(text.split("\n\n")) == 2
    assert max(map(len, text.splitlines())) <= width
    assert "tabletop_organization" in text.replace("\n", "").replace(" ", "")


def test_notes_are_wrapped_to_the_width():
    assert wrapped("one two\nthree", 4) == "one\ntwo\nthre\ne"
    assert wrapped("one two", None) == "one two"
