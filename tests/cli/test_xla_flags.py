"""XLA flags that the command line sets: where the installed XLA knows them, once, and never against the user."""

import time
from importlib.util import find_spec
from pathlib import Path

import pytest

from earl_jax.cli import xla_flags
from tests.cli.process import run_code

NAME = next(iter(xla_flags.FLAGS))
ADDED = [f"--{name}={value}" for name, (value, _) in xla_flags.FLAGS.items()]
JAXLIB = Path(find_spec("jaxlib").origin).parent
TABLE = b"".join(name.encode() + b"\0" + text.encode() + b"\0" for name, (_, text) in xla_flags.FLAGS.items())


@pytest.fixture
def plugin(tmp_path, monkeypatch):
    """A CUDA plugin that knows the flags; jaxlib is the installed one."""
    (tmp_path / "xla_cuda_plugin.so").write_bytes(b"ELF\0" + TABLE)
    monkeypatch.setattr(xla_flags, "cuda_plugin", lambda: tmp_path)
    monkeypatch.setattr(xla_flags, "TRIAL", "")
    monkeypatch.delenv("JAX_PLATFORMS", raising=False)
    monkeypatch.setenv("XLA_FLAGS", "--xla_dump_to=x")
    return tmp_path / "xla_cuda_plugin.so"


@pytest.mark.usefixtures("plugin")
def test_commands_that_train_set_the_flags_and_print_them_once(monkeypatch, capsys):
    for arguments in (["list"], [], ["train", "--help"]):
        xla_flags.set_flags(arguments)
    assert capsys.readouterr().err == ""
    for arguments, printed in ((["train", "sawyer_door"], 1), (["sweep"], 0)):
        xla_flags.set_flags(arguments)
        assert xla_flags.os.environ["XLA_FLAGS"].split() == ["--xla_dump_to=x", *ADDED]
        assert capsys.readouterr().err.count(" ".join(ADDED)) == printed


@pytest.mark.parametrize(
    ("environment", "known", "expected"),
    [
        ({}, TABLE, ADDED),
        ({"XLA_FLAGS": f"--{NAME}=false"}, TABLE, ADDED[1:]),
        ({"XLA_FLAGS": f"--{NAME}"}, TABLE, ADDED[1:]),
        ({"XLA_FLAGS": f"--{NAME}_of_another=1"}, TABLE, ADDED),
        ({"XLA_FLAGS": "/path/of/flags"}, TABLE, []),
        ({"JAX_PLATFORMS": "cpu"}, TABLE, []),
        ({"JAX_PLATFORMS": "cuda,cpu"}, TABLE, ADDED),
        ({}, f"\0{NAME}_of_another\0".encode(), []),
        ({}, TABLE.replace(b"command types", b""), ADDED[:1]),
    ],
)
def test_the_users_flags_and_platform_win_and_the_plugin_knows_a_flag(plugin, environment, known, expected):
    plugin.write_bytes(known)
    assert xla_flags.helpful_flags(environment) == expected


def test_a_flag_that_jaxlib_does_not_know_or_without_a_plugin_is_not_set(plugin, monkeypatch):
    monkeypatch.setattr(xla_flags, "FLAGS", {"xla_no_such_flag": ("1", "")})
    plugin.write_bytes(b"\0xla_no_such_flag\0")
    assert xla_flags.helpful_flags({}) == []
    monkeypatch.undo()
    monkeypatch.setattr(xla_flags, "cuda_plugin", lambda: None)
    assert xla_flags.helpful_flags({}) == []


def test_the_installed_xla_accepts_the_flags_that_it_is_said_to_know():
    began = time.perf_counter()
    flags = xla_flags.FLAGS.items()
    known = [f"--{name}={value}" for name, (value, text) in flags if xla_flags.knows_flag(JAXLIB, name, text)]
    assert time.perf_counter() - began < 1
    assert known, "jaxlib of the supported versions knows them"
    run_code(xla_flags.TRIAL, XLA_FLAGS=" ".join(known))
