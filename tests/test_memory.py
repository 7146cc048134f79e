"""What a run will occupy: computed, told, and refused before anything is written."""

import dataclasses

import jax
import pytest

import earl_jax
from earl_jax.algos import make_algo
from earl_jax.envs import list_envs, make
from earl_jax.protocol import Protocol
from earl_jax.training import init as birth
from earl_jax.training import memory
from earl_jax.training.state import Problem
from tests.conftest import newborn, tiny_method

PUBLISHED = {
    "tabletop_organization": 2.5e6, "sawyer_door": 4e6, "sawyer_peg": 5.9e6, "franka_kitchen": 5e6, "dhand_lightbulb": 5e6,
    "minitaur_pen": 3e6, "cheetah_run": 3e6, "fish_swim": 3e6,
}  # fmt: skip
"""Steps of the published tables; of the two small tasks as many as the minitaur's."""
CARD = 141e9


def loop_of(name):
    env = make(name)
    return Problem(env, Protocol(env.train_horizon, env.eval_horizon))


@pytest.mark.parametrize("name", list_envs())
def test_a_hundred_lanes_of_the_published_length_fit_on_one_card(name):
    assert set(PUBLISHED) == set(list_envs())
    needed = memory.need(loop_of(name), make_algo("r3l"), 100, int(PUBLISHED[name]))
    assert needed.total < 0.95 * CARD


@pytest.mark.parametrize("algo", ["naive", "fbrl", "vaprl"])
def test_the_replay_and_the_agent_are_as_large_as_said(problem, algo):
    method, steps = tiny_method(algo, lanes=3), 300
    needed, lives = memory.need(problem, method, 3, steps), newborn(problem, method, range(3), steps)
    occupied = sum(leaf.nbytes for leaf in jax.tree.leaves(lives.replay))
    assert abs(occupied - 3 * needed.replay) < 200, "counts and the one state more than transitions"
    assert sum(leaf.nbytes for leaf in jax.tree.leaves(lives.lanes)) == 3 * needed.agent
    assert birth.capacity_for(problem, method, steps) >= steps


def test_a_run_that_cannot_fit_says_how_many_lanes_would_and_leaves_nothing(monkeypatch, tmp_path):
    needed = memory.need(loop_of("sawyer_door"), make_algo("naive"), 1, 80)
    monkeypatch.setattr(memory, "free_bytes", lambda device: 3 * needed.lane + 1)
    with pytest.raises(ValueError, match=r"5 lanes take .* GB free: 3 lanes would fit.*XLA_PYTHON_CLIENT_MEM_FRACTION"):
        earl_jax.train("sawyer_door", "naive", seeds=5, steps=80, eval_every=80, out=tmp_path / "run")
    assert not (tmp_path / "run").exists()
    memory.require(dataclasses.replace(needed, lanes=3))


def test_this_machine_says_what_it_has_free():
    free = memory.free_bytes(jax.devices()[0])
    assert free is None or free > 1e8


def test_a_run_tells_its_size_before_it_starts(capsys):
    earl_jax.train(
        "tabletop_organization", "naive", seeds=2, steps=120, eval_every=40, eval_episodes=2, progress=True,
        hidden_sizes=[16, 16], batch_size=16, random_steps=20,
    )  # fmt: skip
    said = " ".join(capsys.readouterr().err.split())
    assert "2 lanes take" in said
    assert said.index("of replay") < said.index("step 120/120")
