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
# A method in forty lines

This page defines a new method: one controller goes to the goal and back, and learns from a share of its
transitions under other goals. The page tests the method's functions and trains it beside the same method
without relabelling. It takes five to ten minutes on two CPU cores.

To open this page in a checkout, run `pip install -e '.[notebook]'` and `jupyter lab`. VS Code also runs
`03_write_a_method.py`, the same page as a script.
"""

# %%
import os
import tempfile
from pathlib import Path
from typing import ClassVar

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

import earl_jax
from earl_jax.algos.goals import GoalIndices, goal_table
from earl_jax.algos.method import BACKWARD, RETURN, TASK, Method, Phase
from earl_jax.metrics.comparison import permutation
from earl_jax.options.presets import PRESETS
from earl_jax.report.style import step_axis

# %matplotlib inline

# %% tags=["parameters"]
TINY = os.environ.get("EARL_JAX_NOTEBOOK") == "tiny"  # the tests run this page with tiny numbers
SEEDS = 2 if TINY else 3  # of each of two settings
STEPS, EVERY = (200, 100) if TINY else (150_000, 10_000)
OPTIONS = {**PRESETS["quick"].options, "random_steps": min(1000, EVERY)}
RUNS = Path(tempfile.mkdtemp(prefix="earl_jax-"))  # use a folder of your own to keep the runs

# %% [markdown]
"""
## The functions

All methods share one loop: act, step, store, sample, learn. A method names its phases and overrides the
functions in which it differs from naive RL (`earl_jax/algos/method.py` has them all). This method has two
phases, the second with the backward demonstrations, and overrides two functions.

**`next_goal`** returns the next goal. A task phase gets a task goal; a return phase gets an initial state.
Goals are indices into one table: task goals, initial states, then every state of the demonstrations.

**`prepare`** returns the sampled transitions with the goals and rewards to learn from. Most keep their own.
A share of them gets another goal from the table, with reward and success recomputed for it. A transition
without a successor, whose next state was overwritten by a reset, keeps its goal.

`share` is a float field, so it is a leaf: every lane of a program can have its own value.
"""


# %%
class AsIf(Method):
    """Go there and back with one controller that learns from a share of its transitions under other goals."""

    share: float = 0.5

    name: ClassVar[str] = "as_if"
    phases: ClassVar[tuple[Phase, ...]] = (Phase(), Phase((BACKWARD,)))

    def next_goal(self, key, goals, phase, current, method_state):
        """Return the goal for the policy and the task that the environment rewards, as indices."""
        task_key, home_key = jax.random.split(key)
        task = goals.draw_task(task_key)
        home = goals.tasks + jax.random.randint(home_key, (), 0, goals.initials)
        back = phase == RETURN
        return GoalIndices(goal=jnp.where(back, home, task), task=jnp.where(back, current.task, task))

    def prepare(self, key, env, goals, batch, phase, method_state):
        """Return the sampled transitions `batch [B]`, a share of them under another goal."""
        share_key, goal_key = jax.random.split(key)
        other = jax.random.randint(goal_key, batch.reward.shape, 0, len(goals.table))
        chosen = jax.random.bernoulli(share_key, self.share, other.shape) & ~batch.flags.no_successor
        obs = jnp.concatenate([batch.next_state, jnp.asarray(goals.table)[other]], axis=-1)
        reached = env.success(obs) & env.sparse
        flags = batch.flags._replace(
            goal=jnp.where(chosen, other, batch.flags.goal),
            reached=jnp.where(chosen, reached, batch.flags.reached),
        )
        return batch._replace(reward=jnp.where(chosen, env.reward(obs), batch.reward), flags=flags)


earl_jax.register_algo(AsIf.name, AsIf)

# %% [markdown]
"""
With a registered name, `train`, plots and tables accept the method like any other. To use it in other
processes too (the command line, sweeps, `resume`), put the class in a file and pass `--import FILE`, as in
[docs/extending.md](../docs/extending.md). When this cell runs again, the new class gets a new program. After
`%autoreload` has changed a class in place, call `jax.clear_caches()`: jax keeps the program of the old code.

## Test it before training

A method consists of pure functions, so you can call them before anything is trained. Here are the goals of
a thousand task phases and a thousand return phases, on the real goal table:
"""

# %%
env = earl_jax.make("tabletop_organization")
goals, method, current = goal_table(env), AsIf(), GoalIndices(jnp.asarray(2), jnp.asarray(2))
print(
    f"goal table: {goals.tasks} task goals, {goals.initials} initial state, {len(goals.candidates):,} demonstrated states"
)
keys = jax.random.split(jax.random.key(0), 1000)
for name, phase in (("task", TASK), ("return", RETURN)):
    drawn = jax.vmap(lambda key, phase=phase: method.next_goal(key, goals, jnp.asarray(phase), current, ()))(keys)
    print(f"{name}: goals {np.unique(drawn.goal).tolist()}, rewarded tasks {np.unique(drawn.task).tolist()}")

# %% [markdown]
"""
## Train it with and without relabelling

Half of the lanes have `share = 0`, which is forward-backward RL with one controller; the others have 0.5.
All lanes run in one program, so nothing else differs between them.
"""

# %%
shares = [0.0] * SEEDS + [0.5] * SEEDS
result = earl_jax.train(
    "tabletop_organization",
    "as_if",
    seeds=2 * SEEDS,
    steps=STEPS,
    eval_every=EVERY,
    eval_episodes=20,
    out=RUNS / "as_if",
    progress=True,
    share=shares,
    **OPTIONS,
)

# %%
success = result.metrics["deployed/success"].reshape(2, SEEDS, -1)
figure, axis = plt.subplots(figsize=(6.5, 3.6), layout="constrained")
for values, share, colour in zip(success, (0.0, 0.5), ("C7", "C0"), strict=True):
    axis.plot(result.steps, values.T, color=colour, alpha=0.3, linewidth=0.8)
    axis.plot(result.steps, values.mean(axis=0), color=colour, linewidth=2, label=f"share {share}")
step_axis(axis)
axis.set(ylabel="deployed success", ylim=(-0.02, 1.02))
axis.grid(alpha=0.3)
axis.legend(frameon=False)
plt.show()

# %%
last = success[:, :, -3:].mean(axis=2)
gap = permutation(last[1], last[0])
print(f"last three evaluations: {last[0].round(2).tolist()} without, {last[1].round(2).tolist()} with")
print(f"difference {gap.difference:+.2f} [{gap.low:+.2f}, {gap.high:+.2f}], p = {gap.p:.2g}")

# %% [markdown]
"""
Three seeds of a small preset do not show whether the method is good. [02](02_compare_two_methods.py) shows
how to decide it, [04](04_run_on_a_gpu.py) how to train enough seeds. Methods that learn something of their
own override three more functions: `init`, `learn` and `refresh`. `earl_jax/algos/r3l.py` is an
example of fewer than 100 lines.
"""
