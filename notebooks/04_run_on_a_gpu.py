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

One lane (a seed with its environment) leaves most of a GPU idle; fifty lanes share one program and its
kernels. This page lists the devices, computes the memory of a run, measures the speed by number of lanes,
and trains fifty seeds. On an H200 that training takes six minutes. The page runs on a CPU too, with small
networks and too few steps to learn: the outputs stored with it are those of two CPU cores shared with
other work, where all success rates are near 0 and the speeds mean little.

To open this page in a checkout, run `pip install -e '.[cuda,notebook]'` (without `cuda` on a CPU) and
`jupyter lab`. VS Code also runs `04_run_on_a_gpu.py`, the same page as a script.
"""

# %%
import os
import tempfile
import time
from pathlib import Path

os.environ.setdefault("XLA_PYTHON_CLIENT_MEM_FRACTION", "0.95")  # before jax is imported; replays fill a GPU

import jax
import matplotlib.pyplot as plt
import numpy as np
from IPython.display import Image, Markdown

import earl_jax
from earl_jax.metrics.comparison import mean_interval
from earl_jax.report.plots import plot_runs
from earl_jax.training.memory import estimate, free_bytes

# %matplotlib inline

# %% tags=["parameters"]
TINY = os.environ.get("EARL_JAX_NOTEBOOK") == "tiny"  # the tests run this page with tiny numbers
GPU = jax.default_backend() == "gpu"
NETWORK = {} if GPU else {"hidden_sizes": [32, 32], "batch_size": 32}  # the paper's, or a small one for a CPU
LANES = [1, 5, 20, 50] if GPU else [1, 4] if TINY else [1, 2, 5, 10]
PRECISIONS = ["tf32", "bf16"] if GPU else ["tf32"]  # a CPU computes either in float32
MEASURED = 2000 if GPU else 40 if TINY else 2000  # steps of a measurement
SEEDS, STEPS, EVERY = (50, 500_000, 10_000) if GPU else (4, 40, 40) if TINY else (10, 20_000, 5000)
RUNS = Path(tempfile.mkdtemp(prefix="earl_jax-"))  # use a folder of your own to keep the runs

# %% [markdown]
"""
## Devices
"""

# %%
for device in jax.devices():
    free = free_bytes(device)
    print(f"{device.device_kind} ({device.platform}): {'unknown' if free is None else f'{free / 1e9:.0f} GB'} free")

# %% [markdown]
"""
## Memory of a run

The memory is known before a run starts: the replay, which keeps 1,000,000 steps for each controller of a
lane, the agent, and the activations of a gradient step. A run that cannot fit is refused, and the message gives
the number of lanes that would fit. The table is for the paper's networks and lengths.
"""

# %%
PUBLISHED = {"tabletop_organization": 2_500_000, "sawyer_door": 4_000_000, "minitaur_pen": 3_000_000}
rows = ["| task | steps | GB of 5 lanes | of 50 | of 100 |", "| --- | --- | --- | --- | --- |"]
for name, steps in PUBLISHED.items():
    env = earl_jax.make(name)
    problem = earl_jax.Problem(env, earl_jax.Protocol(env.train_horizon, env.eval_horizon))
    needs = [estimate(problem, earl_jax.method_for(env, "fbrl"), lanes, steps).total / 1e9 for lanes in (5, 50, 100)]
    rows.append(f"| {name} | {steps:,} | " + " | ".join(f"{gigabytes:.1f}" for gigabytes in needs) + " |")
Markdown("\n".join(rows))

# %% [markdown]
"""
## Speed by number of lanes

The speed is in steps per second of all lanes together, each step with a control step and a gradient step.
The first call compiles the program and stores it in `~/.cache/earl_jax`, where a later start finds it.
The second call is timed, including one evaluation. `precision="bf16"` computes the networks'
products in bfloat16 and everything else in float32.
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
    rates = [speed(lanes, precision) for lanes in LANES]
    axis.plot(LANES, rates, "o-", label=precision)
    print(precision, {lanes: f"{rate:,.0f}" for lanes, rate in zip(LANES, rates, strict=True)})
axis.set(xscale="log", yscale="log", xlabel="lanes", ylabel="steps a second, all lanes")
axis.set_xticks(LANES, labels=[str(lanes) for lanes in LANES])
axis.xaxis.set_minor_locator(plt.NullLocator())
axis.grid(alpha=0.3)
axis.legend(frameon=False)
plt.show()

# %% [markdown]
"""
[docs/performance.md](../docs/performance.md) has whole-training figures of an H200.

## Train

`devices` spreads the lanes over several GPUs of a host. Lanes share nothing, so they do not communicate.
For several hosts, start `earl-jax train --hosts auto`, the same command on each.
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
## More seeds

Five seeds give a mean. Fifty seeds show the distribution behind it: whether most agents are alike, or some
learn and others never do. The band is the 95 % interval of the mean.
"""

# %%
last = result.metrics["deployed/success"][:, -5:].mean(axis=1)
final = mean_interval(last, rate=True)
figure, axis = plt.subplots(figsize=(5.5, 3), layout="constrained")
axis.hist(last, bins=np.linspace(0, 1, 21).tolist(), color="C0", rwidth=0.9)
axis.axvspan(
    final.low, final.high, color="C1", alpha=0.3, label=f"mean {final.value:.2f} [{final.low:.2f}, {final.high:.2f}]"
)
axis.set(xlabel="success of a seed, last five evaluations", ylabel="seeds", xlim=(0, 1))
axis.legend(frameon=False)
plt.show()

# %% [markdown]
"""
From the shell, the same run is `earl-jax train tabletop_organization --algo vaprl --seeds 50
--steps 500000 --out runs/fifty --set precision=bf16`. For grids of runs, grouped into few programs, see
[sweeps](../docs/sweeps.md).
"""
