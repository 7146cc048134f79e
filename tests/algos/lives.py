"""Short lives of the methods that the paper does not have: one program of a step for each, which all their tests share."""

import functools
from typing import Any, NamedTuple

from earl_jax.envs import make
from tests.conftest import CHUNK, advance, make_problem, make_train_state, tiny_method

PHASE = 8
"""Steps of a phase of MEDAL in these lives."""
OPTIONS = {
    "bc": {"random_steps": 0, "pretrain_steps": 60, "pretrain_rate": 3e-3},
    "medal": {"phase_steps": PHASE},
    "risc": {},
    "rlpd": {"utd": 3, "ensemble": 4},
}
PROBLEM = make_problem(make("tabletop_organization"), eval_every=40, eval_episodes=2)


class Life(NamedTuple):
    """Two lanes of `method` at the `start` and at the `end`, `CHUNK` steps with updates later."""

    method: Any
    start: Any
    end: Any


@functools.cache
def lived(algo):
    """Return the life of the method named `algo`."""
    method = tiny_method(algo, **OPTIONS[algo])
    start = make_train_state(PROBLEM, method, [0, 1])
    return Life(method, start, advance(PROBLEM, method, start, CHUNK))
