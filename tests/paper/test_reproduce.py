"""Every table and figure by one command, end to end at the smallest scale, and the runs that the larger scales plan."""

import shutil
import sys
from pathlib import Path
from unittest.mock import Mock

import pytest

from earl_jax import assets
from earl_jax.paper import figure2, reproduce, tradeoff
from earl_jax.report import published
from earl_jax.runs.config import RunConfig
from earl_jax.sweeps import grid, launcher, processes, worker
from earl_jax.sweeps.launcher import Outcome
from earl_jax.sweeps.worker import plan
from tests.cli.process import ADDED, run, succeed
from tests.report.run_files import constant, read_csv, write_run

FURTHER = {"figure2": "curves", "figure3": "visits", "figure4": "seeds"}
"""The end of the name of a second csv."""
PUBLISHED = {
    "table1": "0.94 (0.04)", "table2": "0.012 (0.004)", "figure5": "0.35M", "figure3": "oracle", "figure4": "37.4 %",
    "tradeoff": "The paper's conclusion", "figure2": "200,000",
}  # fmt: skip
"""A text of each report that comes from the paper. The runs of the first serve all but the trade-off and figure 2."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("reproduced")


@pytest.fixture
def planner_in_process(monkeypatch):
    """Plan in this process, and let workers use the suite's compiled programs.

    tests/sweeps/test_launcher.py starts the planner's own process, which takes seconds to import.
    """
    monkeypatch.setattr(launcher, "plan_sweep", lambda path, out, lanes=None, logs=(): plan(path, out.resolve(), lanes))
    for name, value in ADDED.items():
        monkeypatch.setenv(name, value)


@pytest.fixture
def in_process(planner_in_process, monkeypatch):
    """Plan and train in this process; the test of figure 2 starts the worker's own."""

    def train(workers, task, slot):
        events = []
        configs = {name: RunConfig(**config) for name, config in task["runs"].items()}
        worker.work(
            Path(task["out"]),
            configs,
            lambda name, state, detail: events.append({"run": name, "state": state, "detail": detail}),
            progress=False,
        )
        return events

    monkeypatch.setattr(processes.Workers, "run", train)


def planned_runs(name, scale, tmp_path, *tasks, steps=None, **options):
    """Return the path of the grid of an artefact at a scale, and its runs."""
    path = tmp_path / "grid.toml"
    path.write_text(reproduce.grid_text(name, scale, tasks, steps=steps, options=options))
    return path, grid.read(path)


@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=pytest.mark.slow if name in ("figure2", "tradeoff") else ()) for name in PUBLISHED],
)
def test_one_command_ends_in_a_picture_a_table_and_text(folder, name, request):
    """Figures 3 and 4 of finished runs need no checkpoint."""
    request.getfixturevalue("planner_in_process" if name == "figure2" else "in_process")
    if name in ("figure3", "figure4"):
        for checkpoints in folder.glob("runs/*/*/*/checkpoints"):
            shutil.rmtree(checkpoints)
    trains = name in ("figure2", "tradeoff") or not any(folder.glob("runs/*/*/*"))
    output = succeed("reproduce", name, "--scale", "smoke", "--out", folder)
    assert ("0 done now, 0 failed" in output) != trains, output
    further = [f"{name}_{FURTHER[name]}.csv"] if name in FURTHER else []
    files = {f"{name}.csv", f"{name}.md", f"{name}.png", *further}
    assert {path.name for path in (folder / name).iterdir()} == files
    assert all(str(folder / name / file) in output for file in files)
    assert PUBLISHED[name] in (folder / name / f"{name}.md").read_text()
    assert (folder / name / f"{name}.png").stat().st_size > 10_000
    assert len(read_csv(folder / name / f"{name}.csv")) >= 2


def test_the_full_scale_of_the_tables_is_that_of_the_paper_and_figures_share_their_runs(tmp_path):
    _, runs = planned_runs("table1", "full", tmp_path)
    published = {(row["env"], row["algo"]) for row in assets.published("table1")}
    assert len(runs) == 6 * 4 + 3
    assert {(run.env, run.algo) for run in runs} == published
    steps = {run.env: run.schedule.steps for run in runs}
    expected = {"tabletop_organization": 2_500_000, "sawyer_door": 4_000_000, "minitaur_pen": 3_000_000}
    assert expected.items() <= steps.items()
    assert {run.seeds for run in runs} == {(0, 1, 2, 3, 4)}
    assert all(run.options == {} for run in runs)
    assert {(run.schedule.eval_every, run.schedule.eval_episodes) for run in runs} == {(10_000, 10)}
    for name in ("table2", "figure3", "figure4", "figure5"):
        assert set(map(repr, planned_runs(name, "full", tmp_path)[1])) <= set(map(repr, runs))


def test_the_short_scale_is_a_tenth_of_the_paper(tmp_path):
    options = {"precision": "bf16", "demo_file": "😀.npz"}
    _, runs = planned_runs("table1", "short", tmp_path, "tabletop_organization", **options)
    assert {(run.schedule.steps, len(run.seeds)) for run in runs} == {(250_000, 3)}
    assert all(run.options == options for run in runs)
    with pytest.raises(ValueError, match="'cheetah_run'; choose from tabletop_organization"):
        published.training_steps("cheetah_run")


def test_runs_that_are_shorter_than_the_time_between_evaluations_keep_their_length(tmp_path):
    _, runs = planned_runs("figure2", "full", tmp_path, steps=5_000)
    assert {(run.schedule.steps, run.schedule.eval_every) for run in runs} == {(5_000, 5_000)}


def test_figure_2_has_a_program_for_all_horizons_of_a_task_and_the_fish_keeps_its_target_between_resets(tmp_path):
    options = {"fixed_temperature": True, "reward_scale": 0.1}
    path, runs = planned_runs("figure2", "full", tmp_path, **options)
    groups = plan(path, tmp_path / "out")["groups"]
    assert {run.options["train_horizon"] for run in runs} == set(figure2.HORIZONS)
    assert all(options.items() <= run.options.items() for run in runs)
    assert [(group["lanes"], len(group["runs"])) for group in groups] == [(70, 14), (70, 14)]
    configs = [RunConfig(**config) for group in groups for config in group["runs"].values()]
    protocols = [config.protocol(config.build_env()) for config in configs if config.env == "fish_swim"]
    assert len(protocols) == 2 * len(figure2.HORIZONS)
    assert all(protocol.goal_change == protocol.train_horizon for protocol in protocols)


def test_the_trade_off_varies_epsilon_and_the_budget_on_two_tasks(tmp_path):
    path, runs = planned_runs("tradeoff", "full", tmp_path)
    assert {run.env for run in runs} == {"tabletop_organization", "sawyer_door"}
    varied = {(run.algo, *run.options.items()) for run in runs}
    values = [("intervention_chance", value) for value in tradeoff.CHANCES]
    values += [("budget", value) for value in tradeoff.BUDGETS]
    assert varied == {(algo, value) for algo in ("naive", "fbrl") for value in values}
    lanes = sorted(group["lanes"] for group in plan(path, tmp_path / "out")["groups"])
    assert lanes == [5] * 12 + [25] * 4


def test_options_reach_the_sweep_and_a_result_with_unfinished_runs_is_not_written(tmp_path, monkeypatch):
    sweep = Mock(return_value=Outcome({"tabletop_organization/fbrl/x": {"state": "stopped"}}))
    monkeypatch.setattr(reproduce, "sweep", sweep)
    output = succeed("reproduce", "table1", "--out", tmp_path / "out", "--per-device", "auto", "--minutes", "5")
    given = sweep.call_args.kwargs
    assert (given["minutes"].minutes, given["per_device"]) == (5, "auto")
    assert output == "table1 is not written; unfinished runs: tabletop_organization/fbrl/x\n"
    assert not (tmp_path / "out/table1").exists()
    assert reproduce.reproduce("table1", out=str(tmp_path / "out")) == ([], ())


def test_failed_runs_are_named_after_the_files_of_the_others_and_the_exit_code_is_1(tmp_path, monkeypatch):
    def train(file, out, **_):
        done, *failed = grid.read(file)
        write_run(out / done.name, done.env, done.algo, constant(0.5), metrics={"continuing/reward": 0.1})
        return Outcome({spec.name: {"state": "failed"} for spec in failed})

    monkeypatch.setattr(reproduce, "sweep", train)
    code, output, _ = run("reproduce", "table1", "--out", tmp_path)
    assert code == 1
    *files, last = output.splitlines()
    assert str(tmp_path / "table1/table1.csv") in files
    assert last.startswith("failed runs: tabletop_organization/")
    monkeypatch.setattr(reproduce, "sweep", lambda *_, **__: Outcome({name: {"state": "failed"} for name in "ab"}))
    code, output, _ = run("reproduce", "figure2", "--out", tmp_path)
    lines = ["figure2 is not written; no run of it has reached an evaluation", "failed runs: a, b"]
    assert (code, output.splitlines()) == (1, lines)


def test_a_missing_library_is_named_before_any_training(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    with pytest.raises(ValueError, match="plots need matplotlib"):
        reproduce.reproduce("table1", out=tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.usefixtures("in_process")
@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"name": "figure3", "tasks": ["sawyer_door"]}, "figure3 has no task 'sawyer_door'; choose from tabletop"),
        ({"name": "figure6"}, "unknown experiment 'figure6'; did you mean 'figure.'. Choose from table1"),
        ({"name": "table1", "scale": "huge"}, "unknown scale 'huge'; choose from smoke, short, full"),
        ({"name": "table1", "options": {"colour": 1}}, "no option 'colour'"),
        ({"name": "table1", "options": {"rnd_clip": float("inf")}}, "option rnd_clip = Infinity: the grid .* TOML"),
        ({"name": "table1", "options": {"hidden_sizes": 16}}, r"write it as \[\[16\]\]"),
        ({"name": "table1", "options": {"a b": 1}}, "option a b = 1: the grid .* has no such name or value"),
        ({"name": "table1", "steps": -1}, r"steps must lie in \[1, 2147483647\], not -1"),
        ({"name": "table1", "minutes": 0}, r"minutes must lie in \(0, inf\), not 0"),
        ({"name": "table1", "seeds": 0}, "seeds must name at least one, not 0"),
        (
            {"name": "figure2", "options": {"train_horizon": [4, 8], "hidden_sizes": [8, 8], "discount": [0.9, 0.99]}},
            "figure2 cannot have runs that differ in discount; give it one value",
        ),
    ],
)
def test_invalid_arguments_are_reported_and_start_no_run(tmp_path, arguments, message):
    grid = tmp_path / f"{arguments['name']}.toml"
    grid.write_text("# the runs of an earlier call")
    for files in ({grid: "# the runs of an earlier call"}, {}):
        with pytest.raises(ValueError, match=message):
            reproduce.reproduce(**{"out": tmp_path, **arguments})
        assert {path: path.read_text() for path in tmp_path.iterdir()} == files
        grid.unlink(missing_ok=True)
