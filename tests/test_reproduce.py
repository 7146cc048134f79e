"""Every table and figure by one command, end to end at the smallest scale, and what the large scales would run."""

import csv

import pytest

from earl_jax.cli.main import main
from earl_jax.paper import reproduce
from earl_jax.sweeps import grid
from earl_jax.sweeps.planner import plan
from tests.conftest import CACHE

FILES = {
    "table1": {"table1.csv", "table1.md", "table1.png"},
    "table2": {"table2.csv", "table2.md", "table2.png"},
    "curves": {"curves.csv", "curves.md", "curves.png"},
    "figure4": {"figure4.csv", "figure4_visits.csv", "figure4.md", "figure4.png"},
    "figure5": {"figure5.csv", "figure5_seeds.csv", "figure5.md", "figure5.png"},
    "figure2": {"figure2.csv", "figure2.md", "figure2.png"},
}
TOLD = {
    "table1": "0.94 (0.04)", "table2": "0.012 (0.004)", "curves": "0.33M", "figure4": "oracle", "figure5": "37.4 %",
    "figure2": "200,000",
}  # fmt: skip


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("reproduced")


@pytest.fixture(autouse=True)
def cache(monkeypatch):
    monkeypatch.setenv("JAX_COMPILATION_CACHE_DIR", str(CACHE))
    monkeypatch.setenv("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0.2")


def cells_of(name, scale, tmp_path, tasks=None, **options):
    config, path = reproduce.EXPERIMENTS[name], tmp_path / "grid.toml"
    blocks = [config.block(task) for task in tasks or config.tasks]
    path.write_text(reproduce.toml(blocks, reproduce.SCALES[scale], options))
    return path, grid.read(path)


@pytest.mark.parametrize("name", FILES)
def test_one_command_ends_in_a_picture_a_table_and_words(folder, name, capsys):
    """In this order: the runs of the first table serve all but figure 2."""
    main(["reproduce", name, "--scale", "smoke", "--out", str(folder)])
    told = capsys.readouterr().out
    shared = name not in ("table1", "figure2")
    assert ("0 done now, 0 failed" in told) == shared, told
    found = {path.name for path in (folder / name).iterdir()}
    assert found == FILES[name]
    assert all(str(folder / name / file) in told for file in FILES[name])
    assert TOLD[name] in (folder / name / f"{name}.md").read_text()
    assert (folder / name / f"{name}.png").stat().st_size > 10_000
    with (folder / name / f"{name}.csv").open() as handle:
        assert len(list(csv.DictReader(handle))) >= 2


def test_the_full_tables_are_the_papers(tmp_path):
    _, cells = cells_of("table1", "full", tmp_path)
    assert len(cells) == 6 * 4 + 3
    steps = {cell.env: cell.steps for cell in cells}
    assert (steps["tabletop_organization"], steps["sawyer_door"], steps["minitaur_pen"]) == (
        2_500_000,
        4_000_000,
        3_000_000,
    )
    assert {cell.env for cell in cells if cell.algo == "vaprl"} == {
        "tabletop_organization",
        "sawyer_door",
        "sawyer_peg",
    }
    assert {cell.seeds for cell in cells} == {(0, 1, 2, 3, 4)}
    assert all(cell.options == {} and (cell.eval_every, cell.eval_episodes) == (10_000, 10) for cell in cells)
    _, short = cells_of("table1", "short", tmp_path, ["tabletop_organization"], precision="bf16")
    assert {(cell.steps, len(cell.seeds), cell.options["precision"]) for cell in short} == {(250_000, 3, "bf16")}


def test_figures_share_the_runs_of_the_tables(tmp_path):
    _, tables = cells_of("table1", "full", tmp_path)
    for name in ("table2", "curves", "figure4", "figure5"):
        _, cells = cells_of(name, "full", tmp_path)
        assert set(map(repr, cells)) <= set(map(repr, tables))


def test_all_horizons_of_figure_2_live_in_one_program(tmp_path):
    path, cells = cells_of("figure2", "full", tmp_path, ["cheetah_run"])
    assert {cell.options["train_horizon"] for cell in cells} == set(reproduce.HORIZONS)
    found = plan(path, tmp_path / "out")
    assert [(pack["lanes"], len(pack["cells"])) for pack in found["packs"]] == [(70, 14)]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"name": "figure4", "tasks": ["sawyer_door"]}, "figure4 shows nothing of 'sawyer_door'; choose from tabletop"),
        ({"name": "figure3"}, "unknown experiment 'figure3'; choose from table1"),
        ({"name": "table1", "scale": "huge"}, "unknown scale 'huge'; choose from smoke, short, full"),
        ({"name": "table1", "options": {"colour": 1}}, "no option 'colour'"),
    ],
)
def test_mistakes_are_told_and_start_nothing(tmp_path, arguments, words):
    with pytest.raises(ValueError, match=words):
        reproduce.reproduce(**{"out": tmp_path / "out", **arguments})
    assert not (tmp_path / "out" / "runs").exists()
