"""SAC of Stable-Baselines3 on tabletop organization through the gymnasium adapter; prints its results as JSON.

It runs in a process of its own: PyTorch's libraries and those of a software renderer do not work in the same one.
"""

import json

import gymnasium
import torch
from stable_baselines3 import SAC
from stable_baselines3.common.env_checker import check_env

from earl_jax.adapters.gymnasium import env_id

EPISODES, STEPS = 20, 5000


def mean_return(act):
    """Return the mean return of `act(env, obs)` over the same evaluation episodes each time."""
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


def main():
    """Train, evaluate, print."""
    torch.set_num_threads(1)  # small networks on few cores: threads that wait for each other made this ten times slower
    env = gymnasium.make(env_id("tabletop_organization"), reward_type="dense", train_horizon=2000)
    check_env(env)
    agent = SAC(
        "MlpPolicy", env, learning_rate=1e-3, batch_size=128, learning_starts=200, train_freq=2, gamma=0.95, seed=0,
        policy_kwargs={"net_arch": [64, 64]}, device="cpu",
    )  # fmt: skip
    agent.learn(STEPS)
    report = {
        "losses": [float(agent.logger.name_to_value[f"train/{name}_loss"]) for name in ("actor", "critic", "ent_coef")],
        "dones": float(agent.replay_buffer.dones[:STEPS].sum()),
        "interventions": int(env.unwrapped.state.interventions),
        "random": mean_return(lambda env, _: env.action_space.sample()),
        "trained": mean_return(lambda _, obs: agent.predict(obs, deterministic=True)[0]),
    }
    print(json.dumps(report))


if __name__ == "__main__":
    main()
