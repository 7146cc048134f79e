"""Work on the host inside jitted programs: one call or two for all lanes, errors, the cache, and the fallback."""

import functools
import os
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from earl_jax.envs import make
from earl_jax.physics.engines import c
from earl_jax.physics.host_call import service
from tests.cli.process import run_code
from tests.conftest import assert_equal_trees, tiny_train
from tests.envs.programs import first_state, program
from tests.physics.host_work import double, refuse

HOST_ERRORS = (ValueError, RuntimeError)
"""The errors that jax raises for an error inside a program, depending on its dispatch."""
ROWS = jnp.arange(12.0).reshape(4, 3)


@pytest.fixture
def double_service():
    service.register("test.double", double, 2)
    return "test.double"


def start_and_finish(name, row):
    return service.finish(name, service.start(name, row))


def test_jobs_in_progress_may_be_finished_in_any_order(double_service):
    def run(row):
        first, second = service.start(double_service, row), service.start(double_service, row + 1.0)
        second_answer = service.finish(double_service, second)
        return service.finish(double_service, first), second_answer

    first_answer, second_answer = jax.jit(jax.vmap(run))(ROWS)
    np.testing.assert_array_equal(first_answer, 2 * ROWS[:, :2])
    np.testing.assert_array_equal(second_answer, 2 * (ROWS + 1)[:, :2])


def test_other_work_of_the_same_name_leaves_earlier_programs_as_they_are(double_service):
    """The program of a simulator ran the physics of a class that a notebook had defined again since."""
    program = jax.jit(jax.vmap(functools.partial(service.step, double_service)))
    expected, other = program(ROWS), service.register(double_service, lambda rows: -rows[:, :2], 2)
    np.testing.assert_array_equal(jax.vmap(functools.partial(service.step, other))(ROWS), -ROWS[:, :2])
    np.testing.assert_array_equal(program(ROWS), expected)


def test_rows_of_other_types_reach_the_host_as_float32(double_service):
    for dtype in (np.float64, np.int32, np.float16):
        with jax.enable_x64(True):
            row = jnp.asarray(ROWS[1], dtype)
            answers = service.step(double_service, row), start_and_finish(double_service, row)
        for answer in answers:
            np.testing.assert_array_equal(answer, 2 * ROWS[1, :2], strict=True)


def test_an_error_on_the_host_is_raised_by_the_program():
    service.register("test.refuse", refuse, 2)
    with pytest.raises(HOST_ERRORS, match="ValueError: no such state"):
        jax.block_until_ready(jax.jit(lambda row: service.step("test.refuse", row))(ROWS))
    with pytest.raises(HOST_ERRORS, match="no such state"):
        jax.block_until_ready(jax.jit(lambda row: start_and_finish("test.refuse", row))(ROWS[0]))


STEP_FROM_CACHE = """
import jax
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
    total, hit = run_code(STEP_FROM_CACHE).split()
    assert hit == "True"
    assert float(total) == float(state.obs.sum())


def test_on_another_accelerator_a_callback_does_a_whole_step_in_its_second_part(monkeypatch):
    env = make("sawyer_door", engine="c")
    simulator, state, command = env.simulator, first_state(env).data, jnp.ones(2)
    expected = simulator.step(state, command)
    for module in (c, service):
        monkeypatch.setattr(module, "default_backend", lambda: "tpu")
    monkeypatch.setattr(service, "is_foreign", functools.cache(service.is_foreign.__wrapped__))
    with pytest.warns(RuntimeWarning, match="cuda.*jax.pure_callback"):
        pending = simulator.start_step(state, command)
    assert pending.ticket is None
    assert_equal_trees(simulator.finish_step(state, pending), expected)


REFUSED = """
import sys, warnings
from functools import partial
import jax, numpy as np
from jax.sharding import AxisType, PartitionSpec
from earl_jax.physics.host_call import service, xla_ffi
from tests.conftest import tiny_train, to_numpy

xla_ffi.MAJOR_VERSION += 1
with warnings.catch_warnings(record=True) as caught:
    warnings.simplefilter("always", RuntimeWarning)
    result = tiny_train("naive", "sawyer_door", steps=60, eval_every=20)
    service.register("test.increase", lambda rows: rows + 1, 101)
print(*[warning.message for warning in caught if warning.category is RuntimeWarning], sep="\\n")
np.savez(sys.argv[1], *map(to_numpy, jax.tree.leaves((result.metrics, result.train_state))))

mesh, lanes = jax.make_mesh((2,), ("lanes",), axis_types=(AxisType.Auto,)), PartitionSpec("lanes")
increase = jax.vmap(partial(service.step, "test.increase"))
ten_times = lambda rows: jax.lax.scan(lambda rows, _: (increase(rows), None), rows, length=10)[0]
run = jax.shard_map(ten_times, mesh=mesh, in_specs=lanes, out_specs=lanes, check_vma=False)
assert (np.asarray(jax.jit(run)(np.zeros((2000, 101), np.float32))) == 10).all()
"""
TWO_DEVICES = f"{os.environ.get('XLA_FLAGS', '')} --xla_force_host_platform_device_count=2"


@pytest.mark.slow
def test_where_xla_refuses_the_foreign_function_a_callback_trains_bit_for_bit_alike_with_one_warning(tmp_path):
    """In a process whose handlers claim another major version; each device passes more than XLA copies at once."""
    file = tmp_path / "leaves.npz"
    (warning,) = run_code(REFUSED, file, XLA_FLAGS=TWO_DEVICES).splitlines()
    assert "version" in warning
    assert "jax.pure_callback" in warning
    result = tiny_train("naive", "sawyer_door", steps=60, eval_every=20)
    with np.load(file) as leaves:
        assert_equal_trees(list(leaves.values()), (result.metrics, result.train_state))


@pytest.mark.parametrize(("cores", "devices", "count"), [(16, 1, 15), (16, 4, 3), (2, 1, 2), (1, 1, 1), (3, 8, 1)])
def test_the_cores_of_a_device_but_one_have_a_worker_each(monkeypatch, cores, devices, count):
    monkeypatch.setattr(service, "core_count", lambda: cores)
    monkeypatch.setattr(jax, "local_device_count", lambda: devices)
    monkeypatch.setattr(service, "Workers", lambda serve, width, count: count)
    monkeypatch.setattr(service, "Stream", lambda workers, stream: (workers, stream))
    assert service.Service(double, 2).stream_of(SimpleNamespace(stream=7)) == (count, 7)
