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
# Fifty seeds on a GPU

One lane leaves most of a GPU idle; fifty share one program and its kernels. This page asks the machine what it has,
what a run would need, how many lanes pay, and trains as many as fit. On an H200 the fifty seeds below take six
minutes. It runs on a CPU too, with small numbers.

To open this page: `pip install 'earl-jax[cuda,notebook]'`, without `cuda` on a CPU. VS Code runs the file as it is;
for Jupyter, `jupytext --to ipynb 04_run_on_a_gpu.py`.
"""

# %%
import os
import tempfile
import time
from pathlib import Path

os.environ.setdefault("XLA_PYTHON_CLIENT_MEM_FRACTION", "0.95")  # before jax is imported: replays are what fills a GPU

import jax
import matplotlib.pyplot as plt
import numpy as np
from IPython.display import Image, Markdown

import earl_jax
from earl_jax.metrics.statistics import summarise
from earl_jax.protocol import Protocol
from earl_jax.report.plots import plot_runs
from earl_jax.training.memory import free_bytes, need
from earl_jax.training.state import Problem

# %matplotlib inline

# %% tags=["parameters"]
TINY = os.environ.get("EARL_JAX_NOTEBOOK") == "tiny"  # how the tests run this page
GPU = jax.default_backend() == "gpu"
NETWORK = {} if GPU else {"hidden_sizes": [32, 32], "batch_size": 32}  # the paper's, or what a CPU can bear
LANES = [1, 5, 20, 50] if GPU else [1, 4] if TINY else [1, 2, 5, 10]
PRECISIONS = ["tf32", "bf16"] if GPU else ["tf32"]  # a CPU computes either in float32
MEASURED = 2000 if GPU else 40 if TINY else 2000  # steps of a measurement
SEEDS, STEPS, EVERY = (50, 500_000, 10_000) if GPU else (4, 40, 40) if TINY else (10, 20_000, 5000)
RUNS = Path(tempfile.mkdtemp(prefix="earl_jax-"))  # name a folder of your own to keep the runs

# %% [markdown]
"""
## What is here
"""

# %%
for device in jax.devices():
    free = free_bytes(device)
    print(f"{device.device_kind} ({device.platform}): {'unknown' if free is None else f'{free / 1e9:.0f} GB'} free")

# %% [markdown]
"""
## What a run needs

Nothing that a lane has lived through is ever evicted, so memory is known before a run starts: a row of the replay a
step, the agent, the activations of a gradient step. A run that cannot fit is refused with the number of lanes that
would. Here the paper's networks and lengths.
"""

# %%
PUBLISHED = {"tabletop_organization": 2_500_000, "sawyer_door": 4_000_000, "minitaur_pen": 3_000_000}
rows = ["| task | steps | GB of 5 lanes | of 50 | of 100 |", "| --- | --- | --- | --- | --- |"]
for name, steps in PUBLISHED.items():
    env = earl_jax.make(name)
    problem = Problem(env, Protocol(env.train_horizon, env.eval_horizon))
    needs = [need(problem, earl_jax.method_for(env, "fbrl"), lanes, steps).total / 1e9 for lanes in (5, 50, 100)]
    rows.append(f"| {name} | {steps:,} | " + " | ".join(f"{gigabytes:.1f}" for gigabytes in needs) + " |")
Markdown("\n".join(rows))

# %% [markdown]
"""
## How many lanes pay?

Steps a second of all lanes together, each with a control step and a gradient step. The first call of a program
compiles it (kept in `~/.cache/earl_jax`, so that a second start does not); the second is timed, one evaluation
included. `precision="bf16"` computes the networks' products in bfloat16 and everything else in float32.
"""


# %%
def speed(lanes, precision):
    """Return the steps a second of all lanes of one program."""
    options = {**NETWORK, "random_steps": MEASURED // 20, "precision": precision}
    for _ in range(2):
        began = time.perf_counter()
        earl_jax.train(
            "tabletop_organization",
            "naive",
            seeds=lanes,
            steps=MEASURED,
            eval_every=MEASURED,
            eval_episodes=1,
            **options,
        )
    return lanes * MEASURED / (time.perf_counter() - began)


figure, axis = plt.subplots(figsize=(5.5, 3.4), layout="constrained")
for precision in PRECISIONS:
    found = [speed(lanes, precision) for lanes in LANES]
    axis.plot(LANES, found, "o-", label=precision)
    print(precision, {lanes: f"{value:,.0f}" for lanes, value in zip(LANES, found, strict=True)})
axis.set(xscale="log", yscale="log", xlabel="lanes", ylabel="steps a second, all lanes")
axis.set_xticks(LANES, labels=[str(lanes) for lanes in LANES])
axis.minorticks_off()
axis.grid(alpha=0.3)
axis.legend(frameon=False)
plt.show()

# %% [markdown]
"""
[docs/performance.md](../docs/performance.md) has whole-training figures of an H200.

## Train

Lanes spread over several GPUs of a host with `devices`; they share nothing, so that costs nothing. Over hosts:
`earl-jax train --hosts auto`, the same command on each.
"""

# %%
devices = max(count for count in range(1, jax.local_device_count() + 1) if SEEDS % count == 0)
result = earl_jax.train(
    "tabletop_organization",
    "vaprl",
    seeds=SEEDS,
    steps=STEPS,
    eval_every=EVERY,
    out=RUNS / "vaprl",
    checkpoint_every=STEPS,
    progress=True,
    devices=devices,
    precision="bf16" if GPU else "tf32",
    random_steps=min(1000, EVERY),
    **NETWORK,
)
Image(plot_runs([RUNS / "vaprl"], RUNS / "curves.png"), width=900)

# %% [markdown]
"""
## What more seeds say

Five seeds give a mean. Fifty show what is behind it: whether most agents are alike, or some learn and some never do.
The interval is that of the interquartile mean.
"""

# %%
last = result.metrics["deployed/success"][:, -5:].mean(axis=1)
final = summarise(last)
figure, axis = plt.subplots(figsize=(5.5, 3), layout="constrained")
axis.hist(last, bins=np.linspace(0, 1, 21).tolist(), color="C0", rwidth=0.9)
axis.axvspan(
    final.low, final.high, color="C1", alpha=0.3, label=f"IQM {final.iqm:.2f} [{final.low:.2f}, {final.high:.2f}]"
)
axis.set(xlabel="success of a seed, last five evaluations", ylabel="seeds", xlim=(0, 1))
axis.legend(frameon=False)
plt.show()

# %% [markdown]
"""
From the shell the same run is `earl-jax train tabletop_organization --algo vaprl --seeds 50 --steps 500000 --out
runs/fifty --set precision=bf16`; grids of runs, packed into few programs, are [sweeps](../docs/sweeps.md).
"""
