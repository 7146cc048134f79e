"""Compiled programs are kept unless the user has said where or that they should not."""

import os
import subprocess
import sys
from pathlib import Path

import jax

from earl_jax.training import program_cache as cache
from tests.conftest import CACHE

START = """
import time
began = time.perf_counter()
import jax
hits = []
jax.monitoring.register_event_listener(lambda name, **_: hits.append(name.rsplit("/", 1)[-1]))
import earl_jax
earl_jax.train("tabletop_organization", "naive", seeds=2, steps=40, eval_every=40, random_steps=20)
print(hits.count("cache_hits"), hits.count("cache_misses"), time.perf_counter() - began)
"""


def start(folder):
    env = {name: value for name, value in os.environ.items() if not name.startswith("JAX_COMPILATION")}
    command = [sys.executable, "-c", START]
    env["EARL_JAX_CACHE"] = str(folder)
    return [float(word) for word in subprocess.check_output(command, env=env, text=True).split()]


def test_a_second_start_compiles_nothing_and_takes_seconds(tmp_path):
    cold_hits, kept, _ = start(tmp_path)
    hits, _, seconds = start(tmp_path)
    assert cold_hits == 0
    assert hits == kept > 0, "what took too little time to be kept may be compiled again"
    assert seconds < 60, "10 s on a quiet machine; the suite's is busy"


def test_the_folder_is_the_users_choice(monkeypatch):
    assert jax.config.jax_compilation_cache_dir == str(CACHE), "set by conftest, and left alone by training"
    cache.keep_programs()
    assert jax.config.jax_compilation_cache_dir == str(CACHE)
    monkeypatch.setenv("EARL_JAX_CACHE", "/elsewhere")
    assert cache.folder() == Path("/elsewhere")
    monkeypatch.delenv("EARL_JAX_CACHE")
    monkeypatch.setenv("XDG_CACHE_HOME", "/caches")
    assert cache.folder() == Path("/caches/earl_jax/programs")
