"""Worker processes, with the words that a GPU writes written by the test."""

import os
import pickle
import signal
import time

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from earl_jax.envs import make
from earl_jax.physics.engines import c
from earl_jax.physics.host_call.workers import ACTIVE_S, DEPTH, SPAN
from tests.cli.process import run_code
from tests.envs.programs import starts
from tests.physics.host_work import Jobs, refuse, wait_for, where


@pytest.fixture(scope="module")
def jobs():
    return Jobs(where, 3)


def test_each_process_does_an_equal_part_of_the_rows_and_more_start_for_more_rows(jobs):
    for lanes in [1, 2, 1] + [7] * 2 * DEPTH + [2, 3, 1]:
        processes, parts = np.unique(jobs(lanes), return_counts=True)
        assert len(processes) == min(lanes, 3)
        assert os.getpid() not in processes
        assert np.ptp(parts) <= 1


def test_a_worker_that_had_no_part_in_many_jobs_takes_part_again(jobs):
    first = set(jobs(2))
    for _ in range(5 * DEPTH):
        jobs(1)
        time.sleep(2e-3)
    assert set(jobs(2)) == first


def test_a_process_that_is_killed_is_an_error_that_ends_every_wait(jobs):
    os.kill(int(jobs(2)[1]), signal.SIGKILL)
    wait_for(lambda: jobs.workers.error)
    assert jobs.workers.error == "a worker ended with code -9"
    wait_for(lambda: jobs.workers.shared.finished[0] > jobs.number)


def test_numbers_of_jobs_may_pass_the_span_of_a_word():
    jobs = Jobs(lambda rows: where(rows), 2, number=SPAN - DEPTH)
    jobs.workers.shared.asked[:] = range(SPAN - 2 * DEPTH, SPAN - DEPTH)
    for _ in range(3 * DEPTH):
        jobs(2)
    assert jobs.number > SPAN


def cpu_seconds():
    """Return the CPU time that all threads of this process take in 0.3 s of waiting."""
    before = time.process_time()
    time.sleep(0.3)
    return time.process_time() - before


def test_a_thread_of_this_process_calls_what_no_other_process_can_import_and_rests_without_jobs():
    others = cpu_seconds()
    assert set(Jobs(lambda rows: where(rows), 2)(4)) == {os.getpid()}
    time.sleep(2 * ACTIVE_S)
    assert cpu_seconds() - others < 0.02


@pytest.mark.parametrize("serve", [refuse, lambda rows: refuse(rows)])
def test_an_error_is_noted_and_ends_every_wait(serve):
    jobs = Jobs(serve, 1)
    with pytest.raises(AssertionError):
        jobs(2)
    assert jobs.workers.error == "ValueError('no such state')"


ENDED = """
import os, sys
sys.path.append(sys.argv[1])
from tests.physics.host_work import Jobs, where
print(int(Jobs(where, 1)(1)[0]), flush=True)
os._exit(0)
"""


def test_a_process_ends_with_the_one_that_started_it():
    process = int(run_code(ENDED, os.getcwd()))
    wait_for(lambda: not os.path.exists(f"/proc/{process}"))


@pytest.mark.parametrize("name", ["sawyer_door", "minitaur_pen"])
def test_a_copy_of_a_host_for_another_process_has_one_thread_and_the_same_answers(name):
    env = make(name, engine="c")

    def row(state):
        return c.start_step(env.simulator, *env.control(state, jnp.zeros(env.action_size))).payload

    states = starts(env, count=3)
    rows = np.asarray(jax.jit(jax.vmap(row))(states))
    host = c.host_of(env.simulator, states.data.memory.shape[1])
    copy = pickle.loads(pickle.dumps(host))
    assert copy.threads == 1
    np.testing.assert_array_equal(copy(rows), host(rows))
