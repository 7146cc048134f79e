"""Work on the host inside jitted programs: lanes in one call, in two halves, errors, and programs that a cache keeps."""

import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from earl_jax.physics.host_call import service

BROKEN = (ValueError, RuntimeError)
"""What jax raises for an error inside a program, by how it was dispatched."""
ROWS = jnp.arange(12.0).reshape(4, 3)


def doubled(rows, stream):
    assert stream == 0
    return 2 * rows[:, :2]


@pytest.fixture
def served():
    service.register("test.doubled", doubled, 2)
    return "test.doubled"


def halves(name, row):
    return service.land(name, service.launch(name, row), 2)


def test_a_step_answers_every_lane(served):
    answer = jax.jit(jax.vmap(lambda row: service.step(served, row, 2)))(ROWS)
    np.testing.assert_array_equal(answer, 2 * ROWS[:, :2])


def test_two_halves_answer_as_one_does_whatever_the_order_of_landing(served):
    def crossed(row):
        first, second = service.launch(served, row), service.launch(served, row + 1.0)
        late = service.land(served, second, 2)
        return service.land(served, first, 2), late

    one, other = jax.jit(jax.vmap(crossed))(ROWS)
    np.testing.assert_array_equal(one, 2 * ROWS[:, :2])
    np.testing.assert_array_equal(other, 2 * (ROWS + 1)[:, :2])


def test_a_scan_of_two_halves_keeps_its_steps_apart(served):
    grown = jax.jit(lambda row: jax.lax.scan(lambda r, _: (halves(served, r), None), row[:2], length=5)[0])(ROWS[1])
    np.testing.assert_array_equal(grown, 32 * ROWS[1, :2])


def test_an_error_on_the_host_is_the_programs():
    def refuse(rows, stream):
        raise ValueError("no such world")

    service.register("test.refuse", refuse, 2)
    with pytest.raises(BROKEN, match="ValueError: no such world"):
        jax.block_until_ready(jax.jit(lambda row: service.step("test.refuse", row, 2))(ROWS))
    with pytest.raises(BROKEN, match="no such world"):
        jax.block_until_ready(jax.jit(lambda row: halves("test.refuse", row))(ROWS[0]))


def test_a_second_registration_replaces_the_first():
    service.register("test.replaced", doubled, 2)
    service.register("test.replaced", lambda rows, stream: -rows[:, :2], 2)
    np.testing.assert_array_equal(service.step("test.replaced", ROWS[0], 2), -ROWS[0, :2])


CACHED = """
import sys, jax
jax.config.update("jax_compilation_cache_dir", sys.argv[1])
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0)
jax.config.update("jax_persistent_cache_min_entry_size_bytes", 0)
hits = []
jax.monitoring.register_event_listener(lambda name, **_: hits.append(name))
from earl_jax.envs import make
env = make("sawyer_door", physics="c")
state = jax.jit(env.reset)(jax.random.key(0))
hits.clear()
state = jax.jit(env.step)(state, jax.numpy.ones(4))
print(float(state.obs.sum()), "/jax/compilation_cache/cache_hits" in hits)
"""


def test_a_program_with_physics_on_the_host_is_kept_for_the_next_process(tmp_path):
    said = [
        subprocess.run([sys.executable, "-c", CACHED, str(tmp_path)], capture_output=True, text=True, check=True).stdout
        for _ in range(2)
    ]
    (one, missed), (other, hit) = (line.split() for line in said)
    assert (missed, hit) == ("False", "True")
    assert one == other
