# ---
# jupyter:
#   jupytext:
#     cell_markers: '"""'
#     text_representation:
#       extension: .py
#       format_name: percent
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3
# ---

# %% [markdown]
"""
# Five seeds in one program

A gripper carries a mug to one of four coasters, and the environment is not reset between attempts.
Five agents train on this task, each in its own copy of the environment, all in one jitted program on
this machine. The page takes five to ten minutes on two CPU cores.

To open this page in a checkout, run `pip install -e '.[notebook]'` and `jupyter lab`. VS Code also runs
`01_train_five_seeds.py`, the same page as a script.
"""

# %%
import os
import tempfile
from pathlib import Path

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
from IPython.display import Image

import earl_jax
from earl_jax.envs.tabletop import COASTERS, HOME, LIMIT
from earl_jax.options.presets import PRESETS
from earl_jax.report.plots import plot_runs

# %matplotlib inline

# %% tags=["parameters"]
TINY = os.environ.get("EARL_JAX_NOTEBOOK") == "tiny"  # the tests run this page with tiny numbers
SEEDS = 1 if TINY else 5
STEPS, EVERY = (200, 100) if TINY else (150_000, 10_000)
OPTIONS = {**PRESETS["quick"].options, "random_steps": min(1000, EVERY)}
RUNS = Path(tempfile.mkdtemp(prefix="earl_jax-"))  # use a folder of your own to keep the runs

# %% [markdown]
"""
## The environment

The state contains the positions of gripper and mug and whether the mug is held. The observation adds
the goal, which is a state too. The reward is 1 when gripper and mug are at their goal positions, else
0. An action moves the gripper by up to 0.2 on each axis and opens or closes it. The environment never
resets itself. During training, an intervention resets it every `train_horizon` steps.
"""

# %%
env = earl_jax.make("tabletop_organization")
print(f"obs {env.observation_size}, action {env.action_size}, {len(env.goal_states)} goals, H_T {env.train_horizon:,}")
state = env.reset(jax.random.key(0))
state = env.step(state, jnp.array([1.0, 0.0, -1.0]))
print(f"gripper {state.obs[:2]}, mug {state.obs[2:4]}, reward {state.reward}")

# %% [markdown]
"""
## Train

In forward-backward RL, one controller carries the mug to its goal, another brings everything back, and
the two alternate. `OPTIONS` holds the hyper-parameters of the quickstart: smaller networks than the
paper's and three changes that reduce training to minutes (`earl_jax/options/presets.py` names them).
Without it, this is the paper's agent.

The seeds are lanes of one program. They share its code and nothing else: the training of a lane depends
on its seed alone.
"""

# %%
result = earl_jax.train(
    "tabletop_organization",
    "fbrl",
    seeds=SEEDS,
    steps=STEPS,
    eval_every=EVERY,
    eval_episodes=20,
    out=RUNS / "fbrl",
    progress=True,
    **OPTIONS,
)

# %% [markdown]
"""
The left panel shows the deployed score: every 10,000 steps the policy is evaluated from fresh starts,
without learning. The right panel shows the continuing score: the reward that the agent earned during
training. The line is the mean over seeds, and the band is its 95 % interval.
"""

# %%
Image(plot_runs([RUNS / "fbrl"], RUNS / "curves.png"), width=900)

# %% [markdown]
"""
## Read the numbers

Single evaluations of a young policy vary a lot, so the score of a seed is the mean of its last five. Seeds
differ a lot too, which is why we train five of them and print a 95 % interval beside the mean. Every command
of `earl-jax` prints this score.
"""

# %%
score = result.score()
rewards = result.metrics["continuing/reward"][:, -1]
for seed, success, reward in zip(result.seeds, score.scores, rewards, strict=True):
    print(f"seed {seed}: success {success:.2f}, reward per step {reward:.4f}")
print(score)
print(f"{np.mean(np.array(score.scores) > 0.5):.0%} of the seeds over 0.5")
print(f"interventions: {result.metrics['interventions'][:, -1].astype(int).tolist()}")

# %% [markdown]
"""
## Visited positions

Every lane counts the positions that its gripper visited. Without resets, this map shows the whole
life: first the walls, where young policies end up, then the paths between mug, coasters and home.
"""

# %%
figure, [axes] = plt.subplots(1, SEEDS, figsize=(2.3 * SEEDS, 2.6), sharey=True, squeeze=False, layout="constrained")
for seed, axis in zip(range(SEEDS), axes, strict=True):
    visits = np.asarray(earl_jax.select_seed(result.train_state, seed).visits)
    axis.imshow(np.log1p(visits.T), origin="lower", extent=(-LIMIT, LIMIT, -LIMIT, LIMIT), cmap="magma")
    axis.plot(*COASTERS.T, "o", color="white", markersize=4)
    axis.set(title=f"seed {seed}", xlabel="x")
axes[0].set_ylabel("y")
plt.show()

# %% [markdown]
"""
## Watch a policy

`result.policy(lane)` is the greedy task policy, a pure function of an observation. The figure shows four
episodes of the best seed, one for each goal: the gripper's path in blue, the mug's in orange, and the
goal's coaster as a circle. The title is the number of steps before the first success, or 200 without one.
"""

# %%
best = int(np.argmax(score.scores))
policy = result.policy(best)


@jax.jit
def episode(goal):
    """Return the observations [H_E, 12] of one greedy episode."""
    start = env.with_goal(env.reset(jax.random.key(0)), goal)

    def step(state, _):
        state = env.step(state, policy(state.obs))
        return state, state.obs

    return jax.lax.scan(step, start, length=env.eval_horizon)[1]


figure, axes = plt.subplots(1, 4, figsize=(11, 3), sharey=True, layout="constrained")
for goal, axis in zip(env.goal_states, axes, strict=True):
    obs = np.asarray(episode(jnp.asarray(goal)))
    until = int(np.argmax(env.success(jnp.asarray(obs)))) or len(obs)
    axis.plot(*obs[:until, :2].T, color="C0", linewidth=1.2)
    axis.plot(*obs[:until, 2:4].T, color="C1", linewidth=2.5)
    axis.plot(*HOME[2:], "s", color="C1")
    axis.plot(*goal[2:4], "o", markersize=14, fillstyle="none", color="black")
    axis.set(xlim=(-LIMIT, LIMIT), ylim=(-LIMIT, LIMIT), aspect="equal", title=f"{until} steps", xlabel="x")
axes[0].set_ylabel("y")
plt.show()

# %% [markdown]
"""
## The same as one pure function

`train` calls a jitted program in chunks, and logs and saves between them. To run whole lives inside
your own program, use `lifetime`. It is a pure function of its keys, which `jit`
compiles as a whole. Here are five short lifetimes.
"""

# %%
protocol = earl_jax.Protocol(env.train_horizon, env.eval_horizon, eval_every=100, eval_episodes=2)
problem = earl_jax.Problem(env, protocol)
method = earl_jax.make_algo("fbrl", **{**OPTIONS, "random_steps": 100})
keys = jax.random.split(jax.random.key(0), SEEDS)
train_state, metrics = jax.jit(lambda keys: earl_jax.lifetime(problem, method, keys, 200))(keys)
print({name: values.shape for name, values in metrics.items()})

# %% [markdown]
"""
Next: [compare two methods](02_compare_two_methods.py), [write a method](03_write_a_method.py),
[run fifty seeds on a GPU](04_run_on_a_gpu.py).
"""
