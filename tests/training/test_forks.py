"""jax in a process that was forked after jax had started."""

import multiprocessing

import jax
import pytest

import earl_jax

CALLS = {
    "train": lambda: earl_jax.train("tabletop_organization", steps=10),
    "resume": lambda: earl_jax.resume("nowhere"),
    "evaluate": lambda: earl_jax.evaluate("nowhere"),
}


def attempt(name):
    with pytest.raises(earl_jax.InputError, match="forked after jax had started"):
        CALLS[name]()


@pytest.mark.filterwarnings("ignore:os.fork")
@pytest.mark.parametrize("name", CALLS)
def test_a_child_that_cannot_compute_says_so(name):
    jax.devices()
    child = multiprocessing.get_context("fork").Process(target=attempt, args=(name,))
    child.start()
    child.join(30)
    child.kill()
    assert child.exitcode == 0
