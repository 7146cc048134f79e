"""Invalid input is one line; an error in the code of a task or a method keeps its traceback."""

import pytest

from earl_jax import InputError, cli, envs, register_env
from earl_jax.envs.tabletop import TabletopOrganization
from tests.cli.process import run, train


class ShapesDiffer(TabletopOrganization):
    name = "shapes_differ"

    def reward(self, obs):
        raise ValueError("this reward is unfinished")


class FileMissing(TabletopOrganization):
    name = "file_missing"

    def reward(self, obs):
        raise FileNotFoundError("no weights.npz")


@pytest.fixture(autouse=True)
def _registered(monkeypatch):
    monkeypatch.setattr(envs._ENVS, "_table", dict(envs._ENVS._table))
    for env in (ShapesDiffer, FileMissing):
        register_env(env.name, env)


def arguments_for(env, folder):
    arguments = train(folder)
    return [env if argument == "tabletop_organization" else str(argument) for argument in arguments]


@pytest.mark.parametrize(("env", "error"), [(ShapesDiffer, ValueError), (FileMissing, FileNotFoundError)])
def test_an_error_in_a_task_keeps_its_traceback(tmp_path, env, error):
    with pytest.raises(error) as raised:
        cli.main(arguments_for(env.name, tmp_path / "run"))
    assert not isinstance(raised.value, InputError)
    assert any(entry.path.samefile(__file__) for entry in raised.traceback), "the traceback names the task's line"


def test_invalid_input_is_one_line_unless_a_traceback_is_requested():
    code, _, err = run("train", "nowhere")
    assert (code, err.count("\n")) == (2, 1)
    assert err.startswith("earl-jax: unknown env 'nowhere'; choose from")
    with pytest.raises(InputError, match="unknown env 'nowhere'"):
        cli.main(["train", "nowhere", "--traceback"])
