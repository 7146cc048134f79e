"""Work on the host inside jitted programs: one call or two for all lanes, errors, and programs that a cache stores."""

import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from earl_jax.envs import make
from earl_jax.physics.host_call import service
from tests.conftest import CACHE
from tests.envs.programs import first_state, program

HOST_ERRORS = (ValueError, RuntimeError)
"""The errors that jax raises for an error inside a program, depending on its dispatch."""
ROWS = jnp.arange(12.0).reshape(4, 3)


def double(rows, stream):
    assert stream == 0
    return 2 * rows[:, :2]


@pytest.fixture
def double_service():
    service.register("test.double", double, 2)
    return "test.double"


def start_and_finish(name, row):
    return service.finish(name, service.start(name, row), 2)


def test_jobs_in_progress_may_be_finished_in_any_order(double_service):
    def run(row):
        first, second = service.start(double_service, row), service.start(double_service, row + 1.0)
        second_answer = service.finish(double_service, second, 2)
        return service.finish(double_service, first, 2), second_answer

    first_answer, second_answer = jax.jit(jax.vmap(run))(ROWS)
    np.testing.assert_array_equal(first_answer, 2 * ROWS[:, :2])
    np.testing.assert_array_equal(second_answer, 2 * (ROWS + 1)[:, :2])


def test_an_error_on_the_host_is_raised_by_the_program():
    def refuse(rows, stream):
        raise ValueError("no such state")

    service.register("test.refuse", refuse, 2)
    with pytest.raises(HOST_ERRORS, match="ValueError: no such state"):
        jax.block_until_ready(jax.jit(lambda row: service.step("test.refuse", row, 2))(ROWS))
    with pytest.raises(HOST_ERRORS, match="no such state"):
        jax.block_until_ready(jax.jit(lambda row: start_and_finish("test.refuse", row))(ROWS[0]))


STEP_FROM_CACHE = """
import sys, jax
jax.config.update("jax_compilation_cache_dir", sys.argv[1])
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0)
hits = []
from earl_jax.envs import make
env = make("sawyer_door")
state = jax.jit(env.reset)(jax.random.key(0))
jax.monitoring.register_event_listener(lambda name, **_: hits.append(name))
state = jax.jit(env.step)(state, jax.numpy.ones(4))
print(float(state.obs.sum()), "/jax/compilation_cache/cache_hits" in hits)
"""


def test_a_program_with_physics_on_the_host_is_cached_for_the_next_process():
    env = make("sawyer_door")
    state = program(env, "step")(first_state(env), jnp.ones(4))
    command = [sys.executable, "-c", STEP_FROM_CACHE, str(CACHE)]
    total, hit = subprocess.run(command, capture_output=True, text=True, check=True).stdout.split()
    assert hit == "True"
    assert float(total) == float(state.obs.sum())
