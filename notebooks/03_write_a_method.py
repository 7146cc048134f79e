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

What if one controller did both ways, there and back, and learnt from every transition as if it had been asked for
something else? Below is that method, a look at whether it does what it says, and a training run beside the same
method without its idea. About five minutes on two CPU cores.

To open this page: `pip install 'earl-jax[notebook]'`. VS Code runs the file as it is; for Jupyter, `jupytext --to
ipynb 03_write_a_method.py`.
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
from earl_jax.algos.method import RETURN, TASK, Method
from earl_jax.cli.quickstart import PRESET
from earl_jax.metrics.statistics import difference
from earl_jax.report.style import step_axis

# %matplotlib inline

# %% tags=["parameters"]
TINY = os.environ.get("EARL_JAX_NOTEBOOK") == "tiny"  # how the tests run this page
SEEDS = 2 if TINY else 3  # of each of two settings
STEPS, EVERY = (200, 100) if TINY else (150_000, 10_000)
OPTIONS = {**PRESET, "random_steps": min(1000, EVERY)}
RUNS = Path(tempfile.mkdtemp(prefix="earl_jax-"))  # name a folder of your own to keep the runs

# %% [markdown]
"""
## The questions

The loop of every method is the same: act, store, sample, learn. A method answers a few questions about it, and what
it does not answer is naive RL's answer (`earl_jax/algos/method.py` has them all). Ours answers two.

**Which goal next?** (`next_goal`) When a task phase begins, a task goal; when a phase back begins, an initial state.
Goals are indices into one table: task goals, initial states, then every state of the demonstrations.

**Under which goal is a sampled transition learnt from?** (`relabel`) Mostly its own. But a share of them gets another
one of the table, and reward and end are recomputed, as if that had been asked for. A transition whose successor was
lost at an intervention keeps its goal.

`share` is a float field, so it is a leaf: every lane of a program may have its own.
"""


# %%
class AsIf(Method):
    """Go there and back with one controller that learns from a share of its transitions under other goals."""

    share: float = 0.5

    name: ClassVar[str] = "as_if"
    phases: ClassVar[int] = 2
    demo_directions: ClassVar[tuple[str, ...]] = ("forward", "backward")

    def next_goal(self, key, goals, phase, lane, method_state):
        """Return the goal commanded now and the task that the world rewards, as indices."""
        task_key, home_key = jax.random.split(key)
        task = goals.draw_task(task_key)
        home = goals.tasks + jax.random.randint(home_key, (), 0, goals.initials)
        back = phase == RETURN
        return GoalIndices(goal=jnp.where(back, home, task), task=jnp.where(back, lane.task, task))

    def relabel(self, key, env, goals, rows):
        """Return sampled transitions, `rows [B]`, a share of them under another goal."""
        share_key, goal_key = jax.random.split(key)
        other = jax.random.randint(goal_key, rows.reward.shape, 0, len(goals.table))
        chosen = jax.random.bernoulli(share_key, self.share, other.shape) & ~rows.marks.lost
        obs = jnp.concatenate([rows.next_state, jnp.asarray(goals.table)[other]], axis=-1)
        reached = env.success(obs) & env.sparse
        marks = rows.marks._replace(
            goal=jnp.where(chosen, other, rows.marks.goal),
            reached=jnp.where(chosen, reached, rows.marks.reached),
        )
        return rows._replace(reward=jnp.where(chosen, env.reward(obs), rows.reward), marks=marks)


if AsIf.name not in earl_jax.list_algos():  # a cell may run twice
    earl_jax.register_algo(AsIf.name, AsIf)

# %% [markdown]
"""
A name makes it one of the methods here: `train`, plots and tables take it. To have it in other processes too (the
command line, sweeps, `resume`), put the class in a package with an entry point: docs/extending.md, one page.

## Ask it

A method is pure functions, so it can be asked before anything is trained. A thousand task phases and a thousand
phases back, on the real goal table:
"""

# %%
env = earl_jax.make("tabletop_organization")
goals, method, before = goal_table(env), AsIf(), GoalIndices(jnp.asarray(2), jnp.asarray(2))
print(
    f"goal table: {goals.tasks} task goals, {goals.initials} initial state, {len(goals.candidates):,} demonstrated states"
)
for name, phase in (("task", TASK), ("back", RETURN)):
    ask = jax.vmap(lambda key, phase=phase: method.next_goal(key, goals, jnp.asarray(phase), before, ()))
    commands = ask(jax.random.split(jax.random.key(0), 1000))
    print(f"{name}: goals {np.unique(commands.goal).tolist()}, rewarded tasks {np.unique(commands.task).tolist()}")

# %% [markdown]
"""
## Train it beside itself

Half of the lanes have `share = 0`, which is forward-backward RL with one controller; the others 0.5. It is one
program, so nothing else can differ between them.
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
step_axis(axis, "environment steps of a seed")
axis.set(ylabel="deployed success", ylim=(-0.02, 1.02))
axis.grid(alpha=0.3)
axis.legend(frameon=False)
plt.show()

# %%
last = success[:, :, -3:].mean(axis=2)
gap = difference(last[1], last[0])
print(f"last three evaluations: {last[0].round(2).tolist()} without, {last[1].round(2).tolist()} with")
print(f"difference {gap.value:+.2f} [{gap.low:+.2f}, {gap.high:+.2f}]")

# %% [markdown]
"""
Whether it is a good idea is not settled by three seeds of a small preset: [02](02_compare_two_methods.py) says how to
settle it, [04](04_run_on_a_gpu.py) how to afford it. Methods that learn something of their own answer three more
questions, `init_extra`, `learn_extra` and `refresh`; `earl_jax/algos/r3l.py` is an example of 79 lines.
"""
