"""The paper's experiments agree with the tasks and the published tables."""

import pytest

from earl_jax import assets
from earl_jax.envs import PAPER_TASKS, list_envs
from earl_jax.paper import tasks


def test_every_task_of_the_paper_is_registered():
    named = {*PAPER_TASKS, *tasks.FIGURE2_TASKS, *tasks.FIGURE4_TASKS, *tasks.FIGURE5_TASKS}
    assert named <= set(list_envs())
    assert {env for env, _ in tasks.FIGURE2_FINDINGS} == set(tasks.FIGURE2_TASKS)


def test_tasks_and_methods_are_those_of_table_1():
    rows = assets.published("table1")
    assert {row["env"] for row in rows} == set(PAPER_TASKS)
    assert {row["algo"] for row in rows} == set(tasks.METHODS)


def test_methods_that_need_demonstrations_are_left_out_where_there_are_none():
    assert tasks.methods_on("sawyer_door", tasks.METHODS) == tasks.METHODS
    assert tasks.methods_on("minitaur_pen", tasks.METHODS) == ("naive", "fbrl", "r3l", "oracle")


def test_training_steps_are_published_for_the_six_tasks_only():
    assert tasks.training_steps("sawyer_door") == 4_000_000
    with pytest.raises(ValueError, match="'cheetah_run'; choose from tabletop_organization"):
        tasks.training_steps("cheetah_run")
