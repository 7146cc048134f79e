"""An error in a user's task or method keeps its traceback, whatever its type."""

import json
from pathlib import Path

import pytest

from earl_jax import InputError, algos, cli, envs, register_algo, register_env
from earl_jax.algos.naive import Naive
from earl_jax.envs.tabletop import TabletopOrganization
from tests.cli.process import training

ERRORS = {
    "ValueError": lambda: "".index("x"),
    "KeyError": lambda: {}["goal"],
    "FileNotFoundError": lambda: Path("/nowhere/weights.npz").read_bytes(),
    "JSONDecodeError": lambda: json.loads("{"),
    "UnicodeDecodeError": lambda: b"\xff".decode(),
}
PARTS = [("task", part) for part in ("reset", "reward", "transition")]
PARTS += [("method", part) for part in ("init_state", "next_goal", "update_state")]
CASES = [(*part, "FileNotFoundError") for part in PARTS] + [("method", "next_goal", kind) for kind in ERRORS]


@pytest.mark.parametrize(("what", "part", "kind"), CASES)
def test_an_error_in_a_plugin_keeps_its_traceback(what, part, kind, tmp_path, monkeypatch):
    def erring(self, *arguments, **options):
        ERRORS[kind]()

    for registry in (envs._ENVS, algos._ALGOS):
        monkeypatch.setattr(registry, "_table", dict(registry._table))
    base, register = (TabletopOrganization, register_env) if what == "task" else (Naive, register_algo)
    assert hasattr(base, part)
    register("erring", type("Erring", (base,), {part: erring, "name": "erring"}))
    with pytest.raises(Exception) as raised:  # noqa: PT011
        cli.main(training(tmp_path / "run", **({"task": "erring"} if what == "task" else {"algo": "erring"})))
    assert type(raised.value).__name__ == kind
    assert not isinstance(raised.value, InputError)
    assert any(entry.path.samefile(__file__) and entry.name == "erring" for entry in raised.traceback)
