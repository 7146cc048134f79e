"""The code uses the field's words: names of the project's own dialect do not come back."""

import ast
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parent.parent / "earl_jax"
REPLACED = {
    "Lives": "TrainState",
    "Lane": "LaneState",
    "Tally": "Counters",
    "Commands": "GoalIndices",
    "extra": "method_state",
    "init_extra": "init_state",
    "learn_extra": "update_state",
    "Loop": "Problem",
    "step_lives": "train_step",
    "learn": "update",
    "depart": "act_and_start",
    "arrive": "finish_and_store",
    "birth": "init",
    "begin": "init_train_state",
    "newborn": "init_lane",
    "judge": "evaluate_lanes",
    "live": "run_program",
    "launch": "start_step",
    "land": "finish_step",
    "flight": "PendingStep",
    "begun": "state_from_demo",
    "scattered": "reset_uniform",
    "place": "map_position",
    "area": "map_bounds",
    "shown": "render_state",
    "shown_goal": "render_goal",
    "looks": "overlays",
    "dressed": "with_overlay",
    "wish": "goal_marker",
    "canvas": "plot_style",
    "Integration": "PhysicsState",
    "Drive": "Actuator",
    "Crew": "WorkerPool",
    "Marks": "TransitionFlags",
    "Rows": "TransitionBatch",
    "lost": "no_successor",
    "Helped": "HelpBudget",
    "settled": "split_setting",
    "packs": "program groups",
    "form": "program_structure",
    "Cell": "RunSpec",
    "Exhibit": "PaperResult",
    "Cast": "Actor",
    "Album": "VideoEmbedder",
    "say": "emit",
    "told": "message",
    "found": "the name of what was found",
    "one": "the name of the thing",
}
"""Each word that is no identifier any more, and the word that replaced it."""


def identifiers(source: str) -> dict[str, int]:
    """Return every identifier that `source` defines or uses, with its first line."""
    names: dict[str, int] = {}
    for node in ast.walk(ast.parse(source)):
        for field in ("id", "attr", "arg", "name", "asname", "module"):
            value = getattr(node, field, None)
            if isinstance(value, str):
                for name in value.split("."):
                    names.setdefault(name.strip("_"), getattr(node, "lineno", 1))
    return names


def test_identifiers_include_every_kind_of_name():
    source = "import a.b as c\nclass D:\n    def e(self, f, **g): return f'{self.h(i=1)}' + _j_\n"
    assert set("abcDefghij") <= set(identifiers(source))


@pytest.mark.parametrize("path", sorted(PACKAGE.rglob("*.py")), ids=lambda path: str(path.relative_to(PACKAGE)))
def test_code_uses_the_words_of_the_field(path):
    used = identifiers(path.read_text())
    old = [f"line {used[name]}: {name} -> {new}" for name, new in REPLACED.items() if name in used]
    assert not old


def test_file_names_use_the_words_of_the_field():
    stems = {part for path in PACKAGE.rglob("*.py") for part in path.relative_to(PACKAGE).with_suffix("").parts}
    assert not stems & set(REPLACED)
