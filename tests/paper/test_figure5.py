"""Figure 5 on small numbers whose drops are known."""

import pytest

from earl_jax.paper.figure5 import report_of
from earl_jax.report.style import COLOURS
from tests.report.run_files import count_pixels, read_csv


def seed_rows(algo, initial, uniform):
    pairs = zip(initial, uniform, strict=True)
    return [{"algo": algo, "seed": i, "success_initial": a, "success_uniform": b} for i, (a, b) in enumerate(pairs)]


def test_drops_are_compared_with_the_published_ones(tmp_path):
    rows = [
        *seed_rows("oracle", [1.0, 0.8], [0.5, 0.5]),
        *seed_rows("fbrl", [1.0, 1.0], [0.5, 0.6]),
        *seed_rows("vaprl", [1.0, 1.0], [1.0, 1.0]),
        *seed_rows("r3l", [0.0, 0.0], [0.0, 0.1]),
    ]
    csv_file, seeds_file, text_file, picture = report_of(rows).write("figure5", tmp_path / "out")
    methods = {row["algo"]: row for row in read_csv(csv_file)}
    assert list(methods) == ["fbrl", "r3l", "vaprl", "oracle"]
    names = ("initial", "uniform", "drop", "drop_low", "drop_high", "published_drop")
    oracle = [float(methods["oracle"][name]) for name in names]
    assert oracle == pytest.approx([0.9, 0.5, 4 / 9, 0.375, 0.5, 0.374])
    verdicts = {algo: row["verdict"] for algo, row in methods.items()}
    assert verdicts == {"oracle": "larger", "fbrl": "larger", "vaprl": "smaller", "r3l": "-"}
    assert [{name: str(value) for name, value in row.items()} for row in rows] == read_csv(seeds_file)
    line = "| oracle | 2 | 0.900 [0.800, 1.000] | 0.500 [0.500, 0.500] | 44.4 [37.5, 50.0] | 37.4 % | larger |"
    assert line in text_file.read_text()
    assert count_pixels(picture, COLOURS["fbrl"]) > 1000


@pytest.mark.parametrize(("initial", "uniform", "verdict"), [([1.0, 1.0], [0.5, 0.7], "within"), ([1.0], [0.6], "-")])
def test_a_drop_within_the_interval_agrees_and_one_seed_has_no_verdict(initial, uniform, verdict):
    row = report_of(seed_rows("oracle", initial, uniform)).tables[""][0]
    assert (row["verdict"], row["drop"]) == (verdict, pytest.approx(0.4))
