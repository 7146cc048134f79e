"""Settings of jax: they change no number of the package, or a command refuses them with one line that names them."""

import contextlib
import json

import jax
import pytest

from tests.cli.process import ENVIRONMENT, TASK, one_line, run, run_process, succeed, training, unchanged
from tests.report.run_files import change_config

OTHER: dict[str, object] = {
    "jax_default_matmul_precision": "highest",
    "jax_default_prng_impl": "rbg",
    "jax_disable_jit": True,
    "jax_random_seed_offset": 7,
    "jax_threefry_partitionable": False,
}


@contextlib.contextmanager
def configured(**settings):
    """A context in which `jax.config` has these values."""
    before = {name: getattr(jax.config, name) for name in settings}
    try:
        for name, value in settings.items():
            jax.config.update(name, value)
        yield
    finally:
        for name, value in before.items():
            jax.config.update(name, value)


def test_types_promotion_and_transfers_that_a_process_forbids_change_no_number(whole, tmp_path):
    with (
        jax.enable_x64(True),
        jax.numpy_rank_promotion("raise"),
        jax.numpy_dtype_promotion("strict"),
        jax.transfer_guard("disallow"),
    ):
        succeed(*training(tmp_path / "run"))
    assert (tmp_path / "run/metrics.csv").read_bytes() == (whole / "metrics.csv").read_bytes()


def test_a_run_is_not_continued_or_repeated_with_a_setting_that_changes_its_numbers(copy, tmp_path):
    for name, value in OTHER.items():
        with unchanged(copy, but=".lock"), configured(**{name: value}):
            one_line(run("resume", copy), name, str(value), f"unset {name.upper()}")
    for config in (copy, copy / "config.json"):
        with unchanged(copy, but=".lock"), configured(jax_random_seed_offset=7):
            result = run("train", "--config", config, "--out", tmp_path / "other")
        one_line(result, "unset JAX_RANDOM_SEED_OFFSET")
    assert not (tmp_path / "other").exists()


def test_a_config_records_the_settings_and_one_without_them_had_the_defaults(copy):
    recorded = json.loads((copy / "config.json").read_text())["jax"]
    assert set(OTHER) < set(recorded)
    change_config(copy, jax=None)
    with configured(jax_random_seed_offset=7):
        one_line(run("resume", copy), "jax_random_seed_offset 0")
    change_config(copy, jax=recorded | {"jax_random_seed_offset": 7})
    one_line(run("resume", copy), "set JAX_RANDOM_SEED_OFFSET=7")
    change_config(copy, jax=[7])
    one_line(run("resume", copy), "jax must be a dict")


@pytest.mark.slow
def test_variables_that_check_numbers_and_tracers_change_no_number(whole, tmp_path, monkeypatch):
    for name in ("JAX_DEBUG_NANS", "JAX_DEBUG_INFS", "JAX_CHECK_TRACER_LEAKS"):
        monkeypatch.setitem(ENVIRONMENT, name, "1")
    succeed(*training(tmp_path / "run"), by=run_process)
    assert (tmp_path / "run/metrics.csv").read_bytes() == (whole / "metrics.csv").read_bytes()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("JAX_PLATFORMS", "cuda"),
        ("JAX_DEFAULT_DEVICE", "quantum"),
        ("JAX_ENABLE_X64", "maybe"),
        ("XLA_FLAGS", "--xla_force_host_platform_device_count=many"),
    ],
)
def test_a_variable_with_which_jax_does_not_start_is_named_in_one_line(name, value, copy, monkeypatch):
    monkeypatch.setitem(ENVIRONMENT, "CUDA_VISIBLE_DEVICES", "")
    monkeypatch.setitem(ENVIRONMENT, name, value)
    for command in (["train", TASK, "--out", "new"], ["resume", copy]):
        with unchanged(copy, but=".lock"):
            one_line(run_process(*command), f"{name}={value}")
    assert run_process("list")[0] == 0
