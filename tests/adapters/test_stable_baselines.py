"""An agent of Stable-Baselines3 lives on tabletop organization through the gymnasium adapter, and gets better at it."""

import gymnasium
import numpy as np
import pytest

from earl_jax.adapters.gymnasium import env_id

stable_baselines3 = pytest.importorskip("stable_baselines3", reason="pip install 'earl-jax[peers]'")
EPISODES = 20


def mean_return(act):
    """The mean return of `act(env, obs)` over the same evaluation episodes each time."""
    env = gymnasium.make(env_id("tabletop_organization"), mode="eval", reward_type="dense", eval_horizon=100)
    env.action_space.seed(0)
    total = 0.0
    for seed in range(EPISODES):
        (obs, _), over = env.reset(seed=seed), False
        while not over:
            obs, reward, terminated, over, _ = env.step(act(env, obs))
            assert not terminated
            total += reward
    return total / EPISODES


@pytest.fixture
def _one_thread():
    """Small networks on few cores: threads that wait for each other made this ten times slower."""
    torch = pytest.importorskip("torch", reason="pip install 'earl-jax[peers]'")
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


@pytest.mark.slow
@pytest.mark.usefixtures("_one_thread")
def test_sac_learns_from_a_life():
    from stable_baselines3.common.env_checker import check_env

    life = gymnasium.make(env_id("tabletop_organization"), reward_type="dense", train_horizon=2000)
    check_env(life)
    agent = stable_baselines3.SAC(
        "MlpPolicy", life, learning_rate=1e-3, batch_size=128, learning_starts=200, train_freq=2, gamma=0.95, seed=0,
        policy_kwargs={"net_arch": [64, 64]}, device="cpu",
    )  # fmt: skip
    agent.learn(5000)
    losses = [agent.logger.name_to_value[f"train/{name}_loss"] for name in ("actor", "critic", "ent_coef")]
    assert np.isfinite(losses).all()
    assert agent.replay_buffer.dones[:5000].sum() == 0
    assert life.unwrapped.life.interventions >= 2
    random = mean_return(lambda env, _: env.action_space.sample())
    learnt = mean_return(lambda _, obs: agent.predict(obs, deterministic=True)[0])
    assert learnt > random + 50
