"""jax in a process that was forked after jax had started."""

import multiprocessing
import subprocess
import sys

import jax
import pytest

import earl_jax
from earl_jax.adapters.gymnasium import ResetFreeEnv
from earl_jax.training.loading import load_policies, shapes_of


def pretrained(task):
    return earl_jax.pretrained(task, "fbrl")


def policies_of_a_run(task):
    return load_policies(None)


def lanes_of_a_run(task):
    return shapes_of(None)


CALLS = [
    earl_jax.train,
    earl_jax.resume,
    earl_jax.evaluate,
    pretrained,
    policies_of_a_run,
    lanes_of_a_run,
    ResetFreeEnv,
]


def attempt(call):
    with pytest.raises(earl_jax.InputError, match="forked after jax had started"):
        call("tabletop_organization")


@pytest.mark.filterwarnings("ignore:os.fork")
@pytest.mark.parametrize("call", CALLS)
def test_a_child_that_cannot_compute_says_so(call):
    jax.devices()
    child = multiprocessing.get_context("fork").Process(target=attempt, args=(call,))
    child.start()
    child.join(30)
    child.kill()
    assert child.exitcode == 0


NATURAL = """
import multiprocessing
import earl_jax
import jax

def attempt(_):
    try:
        earl_jax.train("tabletop_organization")
    except earl_jax.InputError as error:
        return str(error)

jax.devices()
with multiprocessing.get_context("fork").Pool(1) as pool:
    print(pool.map(attempt, [0]))
"""


def test_a_fork_is_noted_before_anything_trains():
    """It used to be noted from the first use of a function that trains on, and the child waited for ever."""
    ended = subprocess.run([sys.executable, "-c", NATURAL], capture_output=True, text=True, timeout=60, check=True)
    assert "forked after jax had started" in ended.stdout
