"""jax in a process that was forked after jax had started."""

import multiprocessing

import jax
import pytest

import earl_jax


def attempt(call):
    with pytest.raises(earl_jax.InputError, match="forked after jax had started"):
        call("tabletop_organization")


@pytest.mark.filterwarnings("ignore:os.fork")
@pytest.mark.parametrize("call", [earl_jax.train, earl_jax.resume, earl_jax.evaluate])
def test_a_child_that_cannot_compute_says_so(call):
    jax.devices()
    child = multiprocessing.get_context("fork").Process(target=attempt, args=(call,))
    child.start()
    child.join(30)
    child.kill()
    assert child.exitcode == 0
