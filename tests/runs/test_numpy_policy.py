"""Policies in plain NumPy: equal to those of every learner, and able to act where jax cannot be imported."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import earl_jax
from earl_jax.algos.learner.sac import SAC
from earl_jax.algos.learner.td3 import TD3
from earl_jax.envs import HelpBudget
from earl_jax.runs.policies import save_policies
from earl_jax.training.policy import Policy
from tests.cli.process import run_code

SHIPPED = [(task, method) for task, methods in earl_jax.list_pretrained().items() for method in methods]
OBS = np.random.default_rng(1).normal(size=(2, 3, 12)).astype(np.float32)
WITHOUT_JAX = """
import sys
sys.modules["jax"] = None  # an import raises
import numpy as np
from earl_jax import NumpyPolicy
np.save(sys.argv[2], NumpyPolicy.load(sys.argv[1])(np.load(sys.argv[2])))
"""


act = jax.jit(lambda policy, obs: policy(obs))


def policy_of(env, learner):
    agent = jax.jit(lambda key: learner.init(key, env.observation_size, env.action_size))(jax.random.key(3))
    return Policy.of_actor(env, learner, agent.actor)


@pytest.mark.parametrize(("task", "method"), SHIPPED)
def test_a_policy_that_ships_acts_the_same_in_numpy(task, method):
    policy = earl_jax.pretrained(task, method)
    obs = np.random.default_rng(1).normal(scale=0.3, size=(5, policy.obs_size)).astype(np.float32)
    np.testing.assert_allclose(policy.numpy()(obs), act(policy, obs), atol=1e-5)


@pytest.mark.parametrize("kind", [SAC, TD3])
@pytest.mark.parametrize("options", [{"layer_norm": True}, {"precision": "bf16"}])
def test_an_actor_of_every_learner_acts_the_same_in_numpy(env, kind, options):
    policy = policy_of(env, kind(hidden_sizes=(16, 8), **options))
    numpy = policy.numpy()
    assert (type(numpy(OBS)), numpy(OBS).dtype, numpy(OBS).shape) == (np.ndarray, np.float32, (2, 3, 3))
    np.testing.assert_allclose(numpy(OBS), act(policy, OBS), atol=1e-5)
    assert len({numpy, policy.numpy()}) == 2
    assert repr(numpy) == "NumpyPolicy(obs [..., 12] -> action [..., 3], 16-8)"
    with pytest.raises(ValueError, match=r"obs has shape \(11,\), this policy takes \(..., 12\)"):
        numpy(np.zeros(11))


def test_a_saved_policy_without_help_acts_where_jax_cannot_be_imported(env, tmp_path):
    policy = policy_of(HelpBudget(env, budget=5.0), SAC(hidden_sizes=(16,)))
    numpy = policy.numpy()
    np.testing.assert_allclose(numpy(OBS), act(policy, OBS), atol=1e-5)
    numpy.save(tmp_path / "policy")
    np.save(tmp_path / "obs.npy", OBS)
    run_code(WITHOUT_JAX, tmp_path / "policy", tmp_path / "obs.npy")
    np.testing.assert_array_equal(np.load(tmp_path / "obs.npy"), numpy(OBS))
    save_policies(tmp_path / "policies.npz", {"weights": OBS}, step=1, seeds=[0], obs_size=12, action_size=3)
    (tmp_path / "half").write_bytes((tmp_path / "policy").read_bytes()[:-100])
    for other in ("policies.npz", "obs.npy", "half"):
        with pytest.raises(ValueError, match=rf"{other} was not written by .* damaged; of a run: earl_jax\.load"):
            earl_jax.NumpyPolicy.load(tmp_path / other)


def test_a_policy_without_a_numpy_form_is_refused(env):
    class Linear(SAC):
        def greedy(self, actor, obs):
            return 0.1 * super().greedy(actor, obs)

    with pytest.raises(ValueError, match="the learner 'sac' has no NumPy form"):
        policy_of(env, Linear(hidden_sizes=(16,))).numpy()
    one = policy_of(env, SAC(hidden_sizes=(16,)))
    with pytest.raises(ValueError, match="this is a stack of policies: use"):
        jax.tree.map(lambda leaf: jnp.asarray(leaf)[None], one).numpy()
