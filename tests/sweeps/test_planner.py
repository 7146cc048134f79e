"""Tests of the planner: the program groups of a grid, and the errors that it reports before any training."""

import jax
import numpy as np
import pytest

from earl_jax.runs.folder import RunFolder
from earl_jax.sweeps import planner, worker
from earl_jax.training.plan import per_lane
from tests.conftest import make_train_state
from tests.sweeps.conftest import GRID, NAMES

LAYER_NORM = GRID.replace('"oracle"', '"naive", "oracle"') + "layer_norm = [true, false]\n"


def test_a_group_contains_the_runs_that_fit_one_program(tmp_path, grid):
    grid.write_text(LAYER_NORM)
    plan = planner.plan(grid, tmp_path)
    assert [group["lanes"] for group in plan["groups"]] == [4] * 4
    for group in plan["groups"]:
        assert len({("naive" in name, "layer_norm=true" in name) for name in group["runs"]}) == 1


def test_full_autonomy_shares_the_program_of_other_horizons(tmp_path, grid):
    grid.write_text(GRID + "train_horizon = [0, 1000]\nintervention_chance = [0, 1]\n")
    plan = planner.plan(grid, tmp_path)
    assert [group["lanes"] for group in plan["groups"]] == [16]
    horizons = [run["config"]["env_options"]["train_horizon"] for run in plan["runs"].values()]
    assert sorted(horizons) == 4 * [0] + 4 * [1000]


def test_max_lanes_splits_groups_but_no_run(tmp_path, grid):
    grid.write_text(LAYER_NORM)
    plan = planner.plan(grid, tmp_path, max_lanes=3)
    assert [group["lanes"] for group in plan["groups"]] == [2] * 8
    assert sorted(name for group in plan["groups"] for name in group["runs"]) == sorted(plan["runs"])
    with pytest.raises(ValueError, match="has 2 seeds, more than 1 lanes"):
        planner.plan(grid, tmp_path, max_lanes=1)


def test_other_tasks_and_lengths_are_other_programs(tmp_path, grid):
    runs = "[[runs]]\noptions = { wide = true }\n[[runs]]\nsteps = 240\noptions.reward_scale = 1\n"
    grid.write_text(GRID + runs)
    plan = planner.plan(grid, tmp_path)
    assert [group["steps"] for group in plan["groups"]] == [240, 120, 120]
    assert [group["lanes"] for group in plan["groups"]] == [2, 2, 4]


def test_replay_bytes_of_a_plan_match_the_allocated_replay(tmp_path, grid, problem):
    grid.write_text(GRID.replace('"oracle"', '"vaprl"').replace("[1, 10]", "1"))
    plan = planner.plan(grid, tmp_path)
    [run] = plan["runs"].values()
    method = per_lane(worker.parse_config(run["config"]).build_method(), 2)
    replay = make_train_state(problem, method, [0, 1], steps=120).replay
    allocated = sum(leaf.nbytes for leaf in jax.tree.leaves(replay))
    assert plan["groups"][0]["replay_bytes"] == pytest.approx(allocated, rel=0.01)


@pytest.mark.parametrize(
    ("change", "messages"),
    [
        (("oracle", "ppo"), ["unknown algo 'ppo'", "vaprl"]),
        (("tabletop_organization", "cheetah"), ["unknown env 'cheetah'", "sawyer_door"]),
        (
            ("batch_size", "bath_size"),
            ["tabletop_organization/oracle/bath_size=16", "no option 'bath_size'", "discount"],
        ),
        (("steps = 120", "steps = 100"), ["not a multiple of eval_every"]),
        (("seeds = 2", "seeds = [1, 1]"), ["distinct"]),
        (('"oracle"]', '"vaprl"]\n[[runs]]\nenvs = "fish_swim"\nalgos = "vaprl"'), ["vaprl needs demonstrations"]),
    ],
)
def test_invalid_runs_are_refused_in_one_line_before_any_training(tmp_path, grid, change, messages, capsys):
    text = GRID if "[[runs]]" not in change[1] else GRID[: GRID.index("[options]")]
    grid.write_text(text.replace(*change))
    assert worker.print_plan(grid, tmp_path / "out", None) == 2
    error = capsys.readouterr().err
    assert len(error.strip().splitlines()) == 1
    for message in messages:
        assert message in error
    assert not (tmp_path / "out").exists()


def test_folder_of_another_run_is_refused_and_stays_unchanged(tmp_path, grid):
    runs = planner.plan(grid, tmp_path)["runs"]
    config = worker.parse_config(runs[NAMES[0]]["config"])
    folder = RunFolder.create(tmp_path / NAMES[0], config, "kinematic")
    folder.append(config.rows(40, {"deployed/success": np.zeros(2)}))
    assert planner.plan(grid, tmp_path)["groups"][0]["runs"] == NAMES
    before = (folder.path / "config.json").read_bytes()
    grid.write_text(GRID.replace("steps = 120", "steps = 240").replace("seeds = 2", "seeds = 3"))
    with pytest.raises(
        ValueError,
        match=r"seeds \[0, 1\] there, \[0, 1, 2\] in the grid; steps 120 there, 240 in the grid.*another --out",
    ):
        planner.plan(grid, tmp_path)
    assert (folder.path / "config.json").read_bytes() == before
