"""Orders, colours and titles that all figures share."""

from earl_jax.envs import PAPER_TASKS, list_envs
from earl_jax.report.style import COLOURS, colours, method_order, task_order, task_title


def test_methods_keep_their_order_and_colours_whichever_others_are_present():
    assert method_order(["oracle", "mine", "naive", "also", "oracle"]) == ["naive", "oracle", "also", "mine"]
    assert colours(["oracle", "mine"])["oracle"] == COLOURS["oracle"]
    assert colours(["mine", "also"])["mine"] not in COLOURS.values()


def test_tasks_of_the_paper_come_first():
    assert task_order(["fish_swim", "ant", *reversed(PAPER_TASKS)]) == [*PAPER_TASKS, "ant", "fish_swim"]


def test_tasks_have_titles_also_if_they_cannot_be_built_here():
    assert [task_title(env).lower().replace(" ", "_") for env in list_envs()] == list_envs()
    assert task_title("task_of_a_missing_package") == "task_of_a_missing_package"
