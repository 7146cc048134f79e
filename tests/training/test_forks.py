"""jax in a process that was forked after jax had started."""

import multiprocessing
import os

import jax
import pytest

import earl_jax

CALLS = {
    "train": lambda: earl_jax.train("tabletop_organization", steps=10),
    "resume": lambda: earl_jax.resume("nowhere"),
    "evaluate": lambda: earl_jax.evaluate("nowhere"),
}


def attempt(name):
    """End this process with code 0 if the call `name` is refused as it should be."""
    try:
        CALLS[name]()
    except earl_jax.InputError as error:
        os._exit(0 if "forked after jax had started" in str(error) else 1)
    os._exit(2)


@pytest.mark.filterwarnings("ignore:os.fork")
@pytest.mark.parametrize("name", CALLS)
def test_a_child_that_cannot_compute_says_so(name):
    jax.devices()
    child = multiprocessing.get_context("fork").Process(target=attempt, args=(name,))
    child.start()
    child.join(30)
    child.kill()
    assert child.exitcode == 0
