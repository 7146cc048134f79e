"""RLPD: a preset of the learner, in the loop."""

import jax
import numpy as np

from earl_jax.algos import make_algo
from tests.conftest import make_train_state, run_whole, tiny_method


def test_the_preset_has_the_paper_s_learner_and_its_options_can_be_replaced():
    sac = make_algo("rlpd").sac
    values = sac.timeout_bootstrap, sac.layer_norm, sac.demo_share, sac.ensemble, sac.target_subset, sac.backup_entropy
    assert values == (True, True, 0.5, 10, 2, False)
    assert make_algo("rlpd", utd=20).sac.utd == 20


def test_a_step_updates_the_whole_ensemble_as_often_as_asked(problem):
    method = tiny_method("rlpd", utd=3, ensemble=4)
    start = make_train_state(problem, method, [0, 1])
    end = run_whole(problem, method, start, 2)
    agent = end.lanes.agent
    assert {leaf.shape[:3] for leaf in jax.tree.leaves(agent.critics)} == {(2, 1, 4)}
    np.testing.assert_array_equal(agent.moments["critics"].count, [[6], [6]])
    np.testing.assert_array_equal(agent.moments["actor"].count, [[2], [2]])
    moved = [np.abs(a - b).max(axis=tuple(range(3, a.ndim))) for a, b in zip(
        jax.tree.leaves(agent.critics), jax.tree.leaves(start.lanes.agent.critics), strict=True
    )]  # fmt: skip
    assert all((change > 0).all() for change in moved)
