"""Minari datasets: written, and loaded back by Minari."""

import jax.numpy as jnp
import numpy as np
import pytest

from earl_jax.assets import demos
from earl_jax.envs import HelpBudget, make

TASK = "tabletop_organization"


@pytest.fixture
def minari(tmp_path, monkeypatch):
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    return pytest.importorskip("minari", reason="datasets need the extra 'minari'")


@pytest.mark.parametrize("reward_type", ["sparse", "dense"])
def test_demonstrations_are_loaded_back_as_episodes_with_the_rewards_of_the_task(minari, reward_type):
    from earl_jax.adapters.minari import demonstrations

    env, recorded = make(TASK, reward_type=reward_type), demos(TASK, "backward")
    demonstrations(env, "backward", "arm/back-v3")
    loaded = minari.load_dataset("arm/back-v3")
    stops = np.flatnonzero(recorded.ends) + 1
    assert (loaded.total_episodes, loaded.total_steps) == (len(stops), len(recorded.ends))
    rewards = np.asarray(env.reward(jnp.concatenate([episode.observations[1:] for episode in loaded])))
    for episode, start, stop in zip(loaded, [0, *stops[:-1]], stops, strict=True):
        states = np.concatenate([recorded.states[start:stop], recorded.next_states[stop - 1 : stop]])
        np.testing.assert_array_equal(episode.observations[:, : env.state_size], states)
        np.testing.assert_array_equal(episode.observations[:, env.state_size :], recorded.goals[[start] * len(states)])
        np.testing.assert_array_equal(episode.actions, recorded.actions[start:stop])
        np.testing.assert_array_equal(episode.rewards, rewards[start:stop])
        assert [np.flatnonzero(part).tolist() for part in (episode.terminations, episode.truncations)] == (
            [[stop - start - 1], []] if env.sparse else [[], [stop - start - 1]]
        )
    for evaluation in (False, True):
        session = loaded.recover_environment(eval_env=evaluation).unwrapped.session
        assert (session.env, session.mode) == (env, "eval" if evaluation else "train")


def test_names_that_minari_would_refuse_or_that_are_taken_are_one_line_and_leave_no_folder(minari, tmp_path):
    from earl_jax.adapters.minari import demonstrations

    demonstrations(HelpBudget(make(TASK), budget=5.0))
    taken = f"earl_jax/{TASK}/forward-v0"
    assert minari.load_dataset(taken).spec.env_spec is None, "gymnasium has no id for the budget"
    for name, message in [(taken, "dataset .* already exists"), ("two words-v0", "valid name"), ("door", "valid name")]:
        with pytest.raises(ValueError, match=message):
            demonstrations(TASK, dataset=name)
    assert [entry.name for entry in tmp_path.iterdir()] == ["earl_jax"]
