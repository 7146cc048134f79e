"""An error in any part of a user's task or method keeps its traceback, whatever its type."""

import itertools
import json
from pathlib import Path

import pytest

from earl_jax import InputError, cli, register_algo, register_env
from earl_jax.algos.naive import Naive
from earl_jax.envs.tabletop import TabletopOrganization
from tests.cli.process import training

ERRORS = {
    "ValueError": lambda: "".index("x"),
    "TypeError": lambda: 1 + "",
    "KeyError": lambda: {}["goal"],
    "ZeroDivisionError": lambda: 1 // 0,
    "FileNotFoundError": lambda: Path("/nowhere/weights.npz").read_bytes(),
    "JSONDecodeError": lambda: json.loads("{"),
    "UnicodeDecodeError": lambda: b"\xff".decode(),
}
TASK_PARTS = ("reset", "success", "reward", "sample_goal", "transition")
METHOD_PARTS = ("init", "act", "ends_phase", "next_goal", "prepare", "learn")


@pytest.mark.parametrize(("part", "kind"), zip(TASK_PARTS + METHOD_PARTS, itertools.cycle(ERRORS)))
def test_an_error_in_a_plugin_keeps_its_traceback(part, kind, tmp_path, registries):
    def erring(self, *arguments, **options):
        ERRORS[kind]()

    what, base, register = ("algo", Naive, register_algo)
    if part in TASK_PARTS:
        what, base, register = ("task", TabletopOrganization, register_env)
    assert hasattr(base, part)
    cls = type("Erring", (base,), {part: erring, "name": "erring"})
    register("erring", cls)
    with pytest.raises(Exception) as raised:  # noqa: PT011
        cli.main(training(tmp_path / "run", **{what: "erring"}))
    assert type(raised.value).__name__ == kind
    assert not isinstance(raised.value, InputError)
    assert any(str(entry.path) == __file__ and entry.name == "erring" for entry in raised.traceback)
