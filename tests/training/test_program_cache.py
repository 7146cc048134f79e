"""The cache of compiled programs."""

import os
import pwd
import subprocess
import sys
from pathlib import Path
from unittest.mock import Mock

import jax
import pytest
from jax._src import lru_cache

from earl_jax.training import program_cache
from tests.conftest import CACHE, TESTS

TRAIN = """
import sys, warnings
import jax
events = []
jax.monitoring.register_event_listener(lambda name, **_: events.append(name.rsplit("/", 1)[-1]))
import earl_jax
warnings.filterwarnings("error", message=".*compilation cache")
small = dict(hidden_sizes=[16], batch_size=16, random_steps=40)
earl_jax.train("tabletop_organization", "naive", seeds=2, steps=40, eval_every=40, **small)
assert not {"brax", "mujoco", "trimesh"} & set(sys.modules), "they take longer to import than jax"
print(events.count("cache_hits"), events.count("cache_misses"))
"""


def train_with_cache(folder):
    """Return cache hits and misses of a training process whose programs are all cached in `folder`."""
    env = {name: value for name, value in os.environ.items() if not name.startswith("JAX_COMPILATION")}
    env |= {"EARL_JAX_CACHE": str(folder), "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0"}
    output = subprocess.check_output([sys.executable, "-c", TRAIN], env=env, cwd=TESTS.parent, text=True)
    return [int(word) for word in output.split()]


def test_a_second_process_compiles_only_what_a_kill_truncated(tmp_path):
    hits, stored = train_with_cache(tmp_path)
    assert hits == 0
    truncated = min(tmp_path.glob("*-cache"), key=lambda path: path.stat().st_size)
    whole = truncated.read_bytes()
    truncated.write_bytes(whole[: len(whole) // 2])
    assert train_with_cache(tmp_path) == [stored - 1, 1]
    assert truncated.stat().st_size > len(whole) // 2, "it is stored anew"


@pytest.mark.parametrize(
    "damage",
    [
        lambda content: content[:100] + bytes([content[100] ^ 1]) + content[101:],
        lambda content: content[:-1],
        lambda content: content[: -program_cache.CHECKSUM_SIZE],
        lambda content: b"",
    ],
)
def test_a_damaged_program_is_removed(tmp_path, damage):
    cache = program_cache.checked(lru_cache.LRUCache)(str(tmp_path), max_size=-1)
    entry = tmp_path / "key-cache"
    cache.put("key", bytes(range(200)))
    assert cache.get("key") == bytes(range(200))
    entry.write_bytes(damage(entry.read_bytes()))
    assert cache.get("key") is None
    assert not entry.exists()


def test_the_user_chooses_the_folder(monkeypatch):
    assert jax.config.jax_compilation_cache_dir == str(CACHE), "set by conftest"
    program_cache.use_program_cache()
    assert jax.config.jax_compilation_cache_dir == str(CACHE), "and left alone by training"
    monkeypatch.setenv("EARL_JAX_CACHE", "/elsewhere")
    assert program_cache.folder() == Path("/elsewhere")
    monkeypatch.delenv("EARL_JAX_CACHE")
    monkeypatch.setenv("XDG_CACHE_HOME", "/caches")
    assert program_cache.folder() == Path("/caches/earl_jax/programs")


def test_a_user_without_a_home_trains_without_a_cache(monkeypatch):
    for name in ("EARL_JAX_CACHE", "XDG_CACHE_HOME", "HOME"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(pwd, "getpwuid", Mock(side_effect=KeyError))
    config = Mock(jax_compilation_cache_dir=None)
    monkeypatch.setattr(jax, "config", config)
    program_cache.use_program_cache()
    config.update.assert_not_called()
