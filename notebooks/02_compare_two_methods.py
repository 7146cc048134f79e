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

This page trains naive RL and forward-backward RL (FBRL) on tabletop organization with five seeds each. It
estimates their difference and its uncertainty, and shows the limits of five seeds. It takes about ten
minutes on two CPU cores.

To open this page in a checkout, run `pip install -e '.[notebook]'` and `jupyter lab`. VS Code also runs
`02_compare_two_methods.py`, the same page as a script.
"""

# %%
import os
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from IPython.display import Image, Markdown

import earl_jax
from earl_jax.metrics.comparison import Sample, band, detectable_difference, mean_interval, permutation, welch
from earl_jax.options.presets import PRESETS
from earl_jax.report.plots import plot_runs
from earl_jax.report.runs import read
from earl_jax.report.style import colours, step_axis
from earl_jax.report.tables import run_table, tabulate

# %matplotlib inline

# %% tags=["parameters"]
TINY = os.environ.get("EARL_JAX_NOTEBOOK") == "tiny"  # the tests run this page with tiny numbers
METHODS = ["fbrl", "naive"]  # two; `earl-jax compare` tests every pair of more
SEEDS = 5
STEPS, EVERY = (200, 100) if TINY else (100_000, 5_000)
OPTIONS = {**PRESETS["quick"].options, "random_steps": min(1000, EVERY)}
RUNS = Path(tempfile.mkdtemp(prefix="earl_jax-"))  # use a folder of your own to keep the runs

# %% [markdown]
"""
## Train both

Task, seeds, learner and number of steps are the same; only the method differs. Naive RL draws a new goal
wherever it is. FBRL returns home in between, which takes about half of its training steps. The rest of
this page reads the run folders, so a comparison does not need the training process. The runs of a sweep
are folders like these.
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

The table has the score of each method and the reward per step over the lifetime, beside the published values.
These runs are far from the paper's (small networks, a fraction of the steps), so do not compare the
columns. They only show where published values appear.
"""

# %%
Markdown(run_table(tabulate(folders)).text())

# %% [markdown]
"""
## One score per seed

Single evaluations are noisy: 20 episodes of a policy that succeeds half of the time have a standard error
of 0.11, even if all seeds are equal. So a seed's score is the mean of its last five evaluations. The
summary is the mean with a 95 % interval, which is wide for a few seeds, and the share of the seeds that
reach 0.5, because methods more often fail in some seeds than a little in all.
"""

# %%
curves = {algo: read(RUNS / algo) for algo in METHODS}
success = {algo: curves[algo].metrics["deployed/success"] for algo in METHODS}
scores = {algo: values[:, -5:].mean(axis=1) for algo, values in success.items()}
for algo, values in scores.items():
    mean, low, high = mean_interval(values, rate=True)
    share = f"{np.mean(values > 0.5):.0%} over 0.5"
    print(f"{algo:6} mean {mean:.2f} [{low:.2f}, {high:.2f}], {share}  seeds", values.round(2).tolist())

# %% [markdown]
"""
## The difference

Overlapping intervals do not show that two methods are equal, and requiring disjoint intervals is stricter
than 95 %. So test the difference itself. The permutation test asks how often a difference this large
would arise if the seeds were assigned to the methods at random. A few seeds can detect only a large
difference; the last number printed below says how large. The verdict is that of the test. The interval is
Welch's, and near p = 0.05 the two can disagree. `earl-jax compare` prints the same for run folders, with Holm's correction
if there are several pairs.
"""

# %%
gap = permutation(*(scores[algo] for algo in METHODS))
detectable = detectable_difference(*(Sample.of(scores[algo]) for algo in METHODS))
interval = f"{gap.difference:+.2f} [{gap.low:+.2f}, {gap.high:+.2f}], p = {gap.p:.2g}"
print(f"{METHODS[0]} against {METHODS[1]}: {interval}: {gap.verdict}; {SEEDS} seeds each detect {detectable:.2f}")

# %% [markdown]
"""
The right panel shows the difference at every evaluation. Where its band does not contain zero, the
methods differ at that step. One such step among twenty evaluations is expected by chance.
"""

# %%
steps, palette = curves[METHODS[0]].steps, colours(METHODS)
columns = zip(*(success[algo].T for algo in METHODS), strict=True)
gaps = np.array([welch(Sample.of(first), Sample.of(second)) for first, second in columns])
figure, (left, right) = plt.subplots(1, 2, figsize=(10, 3.6), layout="constrained")
for algo in METHODS:
    mean, low, high = band(success[algo], rate=True)
    left.plot(steps, mean, color=palette[algo], label=algo)
    left.fill_between(steps, low, high, color=palette[algo], alpha=0.2, linewidth=0)
left.legend(frameon=False)
left.set(ylabel="deployed success", ylim=(-0.02, 1.02))
right.plot(steps, gaps[:, 0], color="black")
right.fill_between(steps, gaps[:, 1], gaps[:, 2], color="black", alpha=0.15, linewidth=0)
right.axhline(0, color="gray", linewidth=0.8)
right.set_ylabel(f"deployed success, {METHODS[0]} minus {METHODS[1]}")
for axis in (left, right):
    step_axis(axis)
    axis.grid(alpha=0.3)
plt.show()

# %% [markdown]
"""
## The continuing setting

Deployed success measures a policy from a fresh start. The continuing setting measures the reward earned
during training, and the two may disagree: naive RL earns a reward whenever it happens to be near a goal,
while FBRL spends steps on the way home.
"""

# %%
earned = {algo: curves[algo].metrics["continuing/reward"][:, -1] for algo in METHODS}
for algo, values in earned.items():
    estimate = mean_interval(values, rate=True)
    print(f"{algo:6} C(A) {estimate.value:.4f} [{estimate.low:.4f}, {estimate.high:.4f}]")
gap = permutation(*(earned[algo] for algo in METHODS))
print(f"difference {gap.difference:+.4f} [{gap.low:+.4f}, {gap.high:+.4f}], p = {gap.p:.2g}: {gap.verdict}")

# %% [markdown]
"""
## How many seeds?

The interval narrows with the square root of the number of seeds. Resampling the present seeds to other
numbers estimates the gain from more seeds like these. On an H200 fifty take 3.5 times as long as five
([04](04_run_on_a_gpu.py)).
"""

# %%
counts, rng = np.array([2, 3, 5, 10, 20, 50]), np.random.default_rng(0)
figure, axis = plt.subplots(figsize=(5, 3.2), layout="constrained")
means = [[rng.choice(scores[algo], size=(2000, count)).mean(axis=1) for algo in METHODS] for count in counts]
widths = [np.subtract(*np.quantile(first - second, [0.975, 0.025])) for first, second in means]
axis.plot(counts, widths, "o-", color="black")
axis.set(xscale="log", ylim=(0, None), xlabel="seeds of each method", ylabel="width of the difference's interval")
axis.set_xticks(counts, labels=counts)
axis.minorticks_off()
axis.grid(alpha=0.3)
plt.show()
