"""The cache of compiled programs."""

import os
import signal
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import jax

from earl_jax.training import program_cache
from tests.conftest import CACHE, TESTS

TRAIN = """
import sys, time
began = time.perf_counter()
import jax
events = []
jax.monitoring.register_event_listener(lambda name, **_: events.append(name.rsplit("/", 1)[-1]))
import earl_jax
small = dict(hidden_sizes=[16], batch_size=16, random_steps=20)
earl_jax.train("tabletop_organization", "naive", seeds=2, steps=40, eval_every=40, **small)
assert not {"brax", "mujoco", "trimesh"} & set(sys.modules), "they take longer to import than jax"
print(events.count("cache_hits"), events.count("cache_misses"), time.perf_counter() - began)
"""


def environment(folder):
    """Return the environment of a process whose programs are all cached in `folder`, however fast they compile."""
    env = {name: value for name, value in os.environ.items() if not name.startswith("JAX_COMPILATION")}
    return {**env, "EARL_JAX_CACHE": str(folder), "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0"}


def train_with_cache(folder):
    """Return cache hits, misses and seconds of a training process whose programs are cached in `folder`."""
    command = [sys.executable, "-c", TRAIN]
    output = subprocess.check_output(command, env=environment(folder), cwd=TESTS.parent, text=True)
    return [float(word) for word in output.split()]


def test_a_second_process_compiles_nothing_and_starts_within_a_minute(tmp_path):
    cold_hits, stored, _ = train_with_cache(tmp_path)
    hits, _, seconds = train_with_cache(tmp_path)
    assert cold_hits == 0
    assert hits == stored > 0
    assert seconds < 60, "10 s on a quiet machine; the suite's is busy"


COMPILE = """
import os, signal, sys, warnings
import jax
from earl_jax.training import program_cache
from pathlib import Path
if sys.argv[1:] == ["killed"]:  # while an entry is written
    def put(cache, key, value):
        (Path(cache.path) / f"{key}-cache").write_bytes(value[: len(value) // 2])
        os.kill(os.getpid(), signal.SIGKILL)
    program_cache.CheckedCache.put = put
warnings.simplefilter("error")
program_cache.keep_programs()
events = []
jax.monitoring.register_event_listener(lambda name, **_: events.append(name.rsplit("/", 1)[-1]))
assert float(jax.jit(lambda x: x * 2 + 1)(3.0)) == 7.0
print(events.count("cache_hits"))
"""


def compile_with_cache(folder, *arguments):
    """Return the exit code of a process that compiles one program, and its number of cache hits."""
    command = [sys.executable, "-c", COMPILE, *arguments]
    process = subprocess.run(command, env=environment(folder), capture_output=True, text=True)
    return process.returncode, int(process.stdout or 0), process.stderr


def flip_a_bit(content):
    return content[:100] + bytes([content[100] ^ 1]) + content[101:]


def test_a_kill_while_a_program_is_stored_costs_one_compilation(tmp_path):
    assert compile_with_cache(tmp_path, "killed")[0] == -signal.SIGKILL
    (entry,) = tmp_path.iterdir()
    truncated = entry.read_bytes()
    assert compile_with_cache(tmp_path) == (0, 0, "")
    files = SimpleNamespace(path=tmp_path, get=lambda key: (tmp_path / f"{key}-cache").read_bytes())
    assert program_cache.CheckedCache(files).get(entry.name.removesuffix("-cache")) is not None
    assert entry.read_bytes() != truncated


def test_a_damaged_program_is_compiled_and_stored_anew(tmp_path):
    files = SimpleNamespace(path=tmp_path, get=lambda key: (tmp_path / f"{key}-cache").read_bytes())
    files.put = lambda key, value: (tmp_path / f"{key}-cache").write_bytes(value)
    cache, entry = program_cache.CheckedCache(files), tmp_path / "key-cache"
    for damage in (flip_a_bit, lambda content: content[:-1], lambda content: b"", lambda content: content[:-32]):
        cache.put("key", bytes(range(200)))
        assert cache.get("key") == bytes(range(200))
        entry.write_bytes(damage(entry.read_bytes()))
        assert cache.get("key") is None
        assert not entry.exists()


def test_the_user_chooses_the_folder(monkeypatch):
    assert jax.config.jax_compilation_cache_dir == str(CACHE), "set by conftest"
    program_cache.keep_programs()
    assert jax.config.jax_compilation_cache_dir == str(CACHE), "and left alone by training"
    monkeypatch.setenv("EARL_JAX_CACHE", "/elsewhere")
    assert program_cache.folder() == Path("/elsewhere")
    monkeypatch.delenv("EARL_JAX_CACHE")
    monkeypatch.setenv("XDG_CACHE_HOME", "/caches")
    assert program_cache.folder() == Path("/caches/earl_jax/programs")
