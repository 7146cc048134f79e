"""The paper's learning curves on runs written by hand, against numbers computed by hand."""

import pytest

from earl_jax.paper.curves import CURVES
from earl_jax.protocol import Continuing, Deployment
from earl_jax.report.published import crossings_beside
from earl_jax.report.runs import read_methods
from earl_jax.report.style import COLOURS
from tests.report.run_files import KITCHEN, TABLETOP, count_pixels, read_csv, write_run


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """The files of the curves of a sparse task and of a dense one."""
    root = tmp_path_factory.mktemp("curves")
    scores = [[0.2, 1.0], [0.4, 0.6]]
    folders = [
        write_run(root / "a", TABLETOP, "fbrl", scores, steps=(100_000, 200_000), metrics={"continuing/reward": 0.004}),
        write_run(root / "b", KITCHEN, "oracle", [[100.0, 300.0]], steps=(20, 40), metrics={"continuing/reward": 0.0}),
    ]
    return CURVES.write(folders, root / "new" / "out")


def test_curves_hold_means_and_intervals(files):
    rows = {(row["env"], row["metric"], int(row["step"])): row for row in read_csv(files[0])}
    last = rows[TABLETOP, "deployed/success", 200_000]
    assert [float(last[name]) for name in ("mean", "low", "high", "seeds")] == pytest.approx(
        [0.8, 0.8 - 12.7062 * 0.2, 0.8 + 12.7062 * 0.2, 2], abs=1e-4
    )
    assert float(rows[TABLETOP, "deployed/success (trailing 10)", 200_000]["mean"]) == pytest.approx(0.55)
    assert float(rows[KITCHEN, "deployed/return", 40]["mean"]) == 300


def test_the_text_has_crossings_and_areas(files):
    text = files[1].read_text()
    line = (
        "| tabletop_organization | fbrl | 2 | 200,000 | 0.20M [0.10M, -] | 0.86M | - [0.10M, -] | 2.07M | 0.550 (0.035) | "
        "0.0040 (0.0000) | 0.005 |"
    )
    assert f"{line} 0.800 (0.141) | 0.94 |" in text
    assert "| - | - | - | - | 200.0 (0.0) | 0.0000 (0.0000) | - | 300.0 (0.0) | 1203.88 |" in text


@pytest.mark.parametrize(
    "changed",
    [
        {"setting": Continuing()},
        {"setting": Deployment(intervention_chance=0.01)},
        {"env_options": {"wide": True}},
        {"env_options": {"train_horizon": 1_000}},
    ],
)
def test_published_numbers_are_drawn_only_beside_the_papers_task_and_setting(tmp_path, changed):
    """The published crossings of FBRL on tabletop are at 0.86M and 2.07M steps."""
    scores = [[0.2, 1.0], [0.4, 0.6]]
    metrics = {"continuing/reward": 0.004}
    same = write_run(tmp_path / "same", TABLETOP, "fbrl", scores, metrics=metrics, layer_norm=True)
    other = write_run(tmp_path / "other", TABLETOP, "fbrl", scores, metrics=metrics, **changed)
    marks = {path.name: crossings_beside(read_methods([path])[0].curves) for path in (same, other)}
    assert marks == {"same": {0.5: 860_000, 0.9: 2_070_000}, "other": {}}


def test_the_picture_shows_the_methods_that_were_run(files):
    assert count_pixels(files[2], COLOURS["fbrl"]) > 200
    assert count_pixels(files[2], COLOURS["r3l"]) == 0
