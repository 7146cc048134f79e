"""SAC of brax on a lifetime of tabletop organization; prints its metrics as JSON.

test_peers.py runs it with a Python that has a jax on which brax's trainers still work.
"""

import json

import jax
from brax.training.agents.sac import train as sac

from earl_jax.adapters import brax

STEPS, LANES = 4000, 4

if __name__ == "__main__":
    task = {"task": "tabletop_organization", "reward_type": "dense"}
    rows = []
    sac.train(
        environment=brax.ResetFreeEnv(**task),
        eval_env=brax.ResetFreeEnv(**task, mode="eval"),
        wrap_env_fn=brax.wrap_for_training,
        num_timesteps=STEPS,
        episode_length=200,
        num_envs=LANES,
        num_eval_envs=32,
        num_evals=2,
        batch_size=128,
        learning_rate=1e-3,
        discounting=0.95,
        grad_updates_per_step=2,
        min_replay_size=500,
        normalize_observations=True,
        progress_fn=lambda step, metrics: rows.append(
            {"step": step, **{name: float(value) for name, value in metrics.items()}}
        ),
    )
    print(json.dumps({"jax": jax.__version__, "rows": rows}))
