"""The cache of compiled programs."""

import os
import subprocess
import sys
from pathlib import Path

import jax

from earl_jax.training import program_cache
from tests.conftest import CACHE

TRAIN = """
import time
began = time.perf_counter()
import jax
events = []
jax.monitoring.register_event_listener(lambda name, **_: events.append(name.rsplit("/", 1)[-1]))
import earl_jax
earl_jax.train("tabletop_organization", "naive", seeds=2, steps=40, eval_every=40, random_steps=20)
print(events.count("cache_hits"), events.count("cache_misses"), time.perf_counter() - began)
"""


def train_with_cache(folder):
    """Return cache hits, misses and seconds of a training process whose programs are cached in `folder`."""
    env = {name: value for name, value in os.environ.items() if not name.startswith("JAX_COMPILATION")}
    env["EARL_JAX_CACHE"] = str(folder)
    output = subprocess.check_output([sys.executable, "-c", TRAIN], env=env, text=True)
    return [float(word) for word in output.split()]


def test_a_second_process_compiles_nothing_and_starts_within_a_minute(tmp_path):
    cold_hits, stored, _ = train_with_cache(tmp_path)
    hits, _, seconds = train_with_cache(tmp_path)
    assert cold_hits == 0
    assert hits == stored > 0, "programs that compile too fast to be stored may be compiled again"
    assert seconds < 60, "10 s on a quiet machine; the suite's is busy"


def test_the_user_chooses_the_folder(monkeypatch):
    assert jax.config.jax_compilation_cache_dir == str(CACHE), "set by conftest"
    program_cache.keep_programs()
    assert jax.config.jax_compilation_cache_dir == str(CACHE), "and left alone by training"
    monkeypatch.setenv("EARL_JAX_CACHE", "/elsewhere")
    assert program_cache.folder() == Path("/elsewhere")
    monkeypatch.delenv("EARL_JAX_CACHE")
    monkeypatch.setenv("XDG_CACHE_HOME", "/caches")
    assert program_cache.folder() == Path("/caches/earl_jax/programs")
