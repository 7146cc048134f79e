"""Orders, colours and titles that all figures share."""

import pytest

from earl_jax.envs import PAPER_TASKS, list_envs
from earl_jax.report.style import COLOURS, colours, method_order, task_order, task_title


def test_methods_keep_their_order_and_colours_whichever_others_are_present():
    assert method_order(["oracle", "mine", "naive", "also", "oracle"]) == ["naive", "oracle", "also", "mine"]
    assert colours(["oracle", "mine"])["oracle"] == COLOURS["oracle"]
    assert colours(["mine", "also"])["mine"] not in COLOURS.values()


def test_tasks_of_the_paper_come_first():
    assert task_order(["fish_swim", "ant", *reversed(PAPER_TASKS)]) == [*PAPER_TASKS, "ant", "fish_swim"]


@pytest.mark.parametrize("env", list_envs())
def test_tasks_have_titles(env):
    assert task_title(env).lower().replace(" ", "_") == env


def test_the_title_of_a_task_that_cannot_be_built_is_its_name():
    assert task_title("task_of_a_missing_package") == "task_of_a_missing_package"
