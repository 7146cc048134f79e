"""XLA flags that the command line sets: where the installed XLA knows them, once, and never against the user."""

import pytest

from earl_jax.cli import xla_flags

NAME = next(iter(xla_flags.FLAGS))
ADDED = [f"--{name}={value}" for name, value in xla_flags.FLAGS.items()]


@pytest.fixture
def plugin(tmp_path, monkeypatch):
    """A CUDA plugin beside the installed jaxlib, whose XLA knows the flags."""
    monkeypatch.setattr(xla_flags, "cuda_plugin", lambda: tmp_path)
    monkeypatch.delenv("JAX_PLATFORMS", raising=False)
    monkeypatch.setenv("XLA_FLAGS", "--xla_force_host_platform_device_count=1")


@pytest.mark.usefixtures("plugin")
def test_commands_that_train_set_the_flags_and_print_them_once(capsys):
    for arguments in (["list"], [], ["train", "--help"]):
        xla_flags.set_flags(arguments)
    assert capsys.readouterr().err == ""
    for arguments, printed in ((["train", "sawyer_door"], 1), (["sweep"], 0)):
        xla_flags.set_flags(arguments)
        assert xla_flags.os.environ["XLA_FLAGS"].split() == ["--xla_force_host_platform_device_count=1", *ADDED]
        assert capsys.readouterr().err.count(" ".join(ADDED)) == printed


@pytest.mark.usefixtures("plugin")
@pytest.mark.parametrize(
    ("environment", "expected"),
    [
        ({}, ADDED),
        ({"XLA_FLAGS": f"--{NAME}=false"}, ADDED[1:]),
        ({"XLA_FLAGS": f"--{NAME}"}, ADDED[1:]),
        ({"XLA_FLAGS": f"--{NAME}_of_another=1"}, ADDED),
        ({"XLA_FLAGS": "/path/of/flags"}, []),
        ({"JAX_PLATFORMS": "cpu"}, []),
        ({"JAX_PLATFORMS": "cuda,cpu"}, ADDED),
    ],
)
def test_the_users_flags_and_platform_win(environment, expected):
    assert xla_flags.helpful_flags(environment) == expected


@pytest.mark.usefixtures("plugin")
@pytest.mark.parametrize("unknown", [{"xla_no_such_flag": "1"}, {"xla_gpu_enable_command_buffer": "+NO_SUCH_COMMAND"}])
def test_a_flag_or_a_value_that_xla_does_not_know_or_without_a_plugin_is_not_set(unknown, monkeypatch):
    monkeypatch.setattr(xla_flags, "FLAGS", {NAME: xla_flags.FLAGS[NAME], **unknown})
    assert xla_flags.helpful_flags({}) == ADDED[:1]
    monkeypatch.setattr(xla_flags, "cuda_plugin", lambda: None)
    assert xla_flags.helpful_flags({}) == []
