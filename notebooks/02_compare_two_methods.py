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
# Is one method better than another?

Naive RL and forward-backward RL on tabletop organization, five seeds each: what their difference is, how sure one can
be of it, and what five seeds cannot tell. About ten minutes on two CPU cores.

To open this page: `pip install 'earl-jax[notebook]'`. VS Code runs the file as it is; for Jupyter, `jupytext --to
ipynb 02_compare_two_methods.py`.
"""

# %%
import os
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from IPython.display import Image, Markdown

import earl_jax
from earl_jax.cli.quickstart import PRESET
from earl_jax.metrics.statistics import bootstrap, difference, iqm, mean_of, summarise
from earl_jax.report.plots import plot_runs
from earl_jax.report.runs import read
from earl_jax.report.style import colours, step_axis
from earl_jax.report.tables import markdown, tabulate

# %matplotlib inline

# %% tags=["parameters"]
TINY = os.environ.get("EARL_JAX_NOTEBOOK") == "tiny"  # how the tests run this page
METHODS = ["fbrl", "naive"]
SEEDS = 5
STEPS, EVERY = (200, 100) if TINY else (200_000, 10_000)
OPTIONS = {**PRESET, "random_steps": min(1000, EVERY)}
RUNS = Path(tempfile.mkdtemp(prefix="earl_jax-"))  # name a folder of your own to keep the runs

# %% [markdown]
"""
## Train both

Same task, same seeds, same learner, same number of steps. Only the method differs: naive RL draws a new goal wherever
it is; FBRL goes home in between, and spends about half of its life on that. From here on all is read from the run
folders, so a comparison never needs the training process again. Runs of a sweep are folders like these.
"""

# %%
for algo in METHODS:
    earl_jax.train(
        "tabletop_organization",
        algo,
        seeds=SEEDS,
        steps=STEPS,
        eval_every=EVERY,
        eval_episodes=20,
        out=RUNS / algo,
        progress=True,
        **OPTIONS,
    )
folders = [RUNS / algo for algo in METHODS]
Image(plot_runs(folders, RUNS / "curves.png"), width=900)

# %% [markdown]
"""
## The paper's tables

The last evaluation and the reward a step over the lifetime, beside the published figures. These runs are far from the
paper's (small networks, a fraction of the steps), so the columns are there to show where published numbers go, not to
be compared.
"""

# %%
Markdown(markdown(tabulate(folders)))

# %% [markdown]
"""
## A number a seed

Single evaluations are noisy: 20 episodes of a policy that succeeds half of the time have a standard error of 0.11
before seeds differ at all. So a seed's score is the mean of its last five evaluations. Summaries: mean, standard
error as the paper prints it, and the interquartile mean, which one unlucky seed cannot drag, with its bootstrap
interval over seeds.
"""

# %%
curves = {algo: read(RUNS / algo) for algo in METHODS}
success = {algo: found.metrics["deployed/success"] for algo, found in curves.items()}
scores = {algo: values[:, -5:].mean(axis=1) for algo, values in success.items()}
for algo, values in scores.items():
    one = summarise(values)
    print(
        f"{algo:6} mean {one.mean:.2f} ({one.stderr:.2f}), IQM {one.iqm:.2f} [{one.low:.2f}, {one.high:.2f}]", end="  "
    )
    print("seeds", values.round(2).tolist())

# %% [markdown]
"""
## The difference

Two intervals that overlap do not say that two methods are equal, and two that do not overlap say more than 95 %. What
is asked is the difference, so that is what is resampled: seeds of either method, with replacement, 2,000 times. If
its interval holds 0, these runs do not tell the methods apart.
"""

# %%
gap = difference(*(scores[algo] for algo in METHODS))
verdict = "not told apart" if gap.low <= 0 <= gap.high else "told apart"
print(
    f"{METHODS[0]} minus {METHODS[1]}: {gap.value:+.2f} [{gap.low:+.2f}, {gap.high:+.2f}]: {verdict} by {SEEDS} seeds each"
)

# %% [markdown]
"""
The same at every evaluation. Where the band leaves zero, the methods differ at that step; one excursion among twenty
evaluations is what chance alone would give.
"""

# %%
steps, palette = curves[METHODS[0]].steps, colours(METHODS)
gaps = np.array([difference(*columns) for columns in zip(*(success[algo].T for algo in METHODS), strict=True)])
figure, (left, right) = plt.subplots(1, 2, figsize=(10, 3.6), layout="constrained")
for algo in METHODS:
    low, high = np.array([bootstrap(column, iqm) for column in success[algo].T]).T
    left.plot(steps, iqm(success[algo], axis=0), color=palette[algo], label=algo)
    left.fill_between(steps, low, high, color=palette[algo], alpha=0.2, linewidth=0)
left.legend(frameon=False)
left.set(title="Deployed success, IQM", ylim=(-0.02, 1.02))
right.plot(steps, gaps[:, 0], color="black")
right.fill_between(steps, gaps[:, 1], gaps[:, 2], color="black", alpha=0.15, linewidth=0)
right.axhline(0, color="gray", linewidth=0.8)
right.set_title(f"{METHODS[0]} minus {METHODS[1]}")
for axis in (left, right):
    step_axis(axis, "environment steps of a seed")
    axis.grid(alpha=0.3)
plt.show()

# %% [markdown]
"""
## Judged while they live

Deployed success says what a policy can do from a fresh start. The continuing setting asks what was earned on the way,
and the two may disagree: naive RL earns a reward wherever it happens to stand near a goal, FBRL pays for its way
home.
"""

# %%
earned = {algo: found.metrics["continuing/reward"][:, -1] for algo, found in curves.items()}
for algo, values in earned.items():
    estimate = mean_of(values)
    print(f"{algo:6} C(A) {estimate.value:.4f} [{estimate.low:.4f}, {estimate.high:.4f}]")
gap = difference(*(earned[algo] for algo in METHODS))
print(f"difference {gap.value:+.4f} [{gap.low:+.4f}, {gap.high:+.4f}]")

# %% [markdown]
"""
## How many seeds?

The interval narrows with the root of their number. Resampling the seeds at hand to other numbers shows what more of
them would buy, if they are like these. On a GPU fifty cost little more than five ([04](04_run_on_a_gpu.py)).
"""

# %%
counts, rng = np.array([2, 3, 5, 10, 20, 50]), np.random.default_rng(0)
figure, axis = plt.subplots(figsize=(5, 3.2), layout="constrained")
means = [[rng.choice(scores[algo], size=(2000, count)).mean(axis=1) for algo in METHODS] for count in counts]
widths = [np.subtract(*np.quantile(one - other, [0.975, 0.025])) for one, other in means]
axis.plot(counts, widths, "o-", color="black")
axis.set(xscale="log", ylim=(0, None), xlabel="seeds of each method", ylabel="width of the difference's interval")
axis.set_xticks(counts, labels=counts)
axis.minorticks_off()
axis.grid(alpha=0.3)
plt.show()
