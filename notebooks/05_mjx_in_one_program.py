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
# Physics, learner and metrics in one program

With `engine="mjx"` a task is simulated by MuJoCo MJX, so every step is XLA: it can be jitted, vmapped and
scanned, and no program calls the host. This page steps such a task, compares it with MuJoCo's C engine,
trains a sweep of whole lifetimes with their statistics in one jitted function, and ends with a run folder.
It takes about ten minutes on two CPU cores, most of them for compilation. MJX is made for GPUs and TPUs; on
a CPU, `auto` takes the C engine because that is faster.

To open this page in a checkout, run `pip install -e '.[notebook]'` and `jupyter lab`. VS Code also runs
`05_mjx_in_one_program.py`, the same page as a script.
"""

# %%
import os
import tempfile
import time
from pathlib import Path

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
from IPython.display import Markdown

import earl_jax
from earl_jax.metrics.scores import deployed_area
from earl_jax.metrics.statistics import summarise
from earl_jax.report.style import step_axis

# %matplotlib inline

# %% tags=["parameters"]
TINY = os.environ.get("EARL_JAX_NOTEBOOK") == "tiny"  # the tests run this page with tiny numbers
TASK = "fish_swim"  # the cheapest task to compile: nothing collides; any MuJoCo task works here
SEEDS = 2 if TINY else 3
HORIZON = 10 if TINY else 200  # steps of an evaluation
STEPS, EVERY = (40, 20) if TINY else (10_000, 2000)
NETWORK = {"hidden_sizes": (16,), "batch_size": 16} if TINY else {"hidden_sizes": (64, 64), "batch_size": 64}
RANDOM_STEPS = EVERY // 2
RATES = [3e-4, 1e-3]  # learning rates to compare
RUNS = Path(tempfile.mkdtemp(prefix="earl_jax-"))  # use a folder of your own to keep the runs

# %% [markdown]
"""
## A task on MJX

The option `engine` selects MJX everywhere: here, in `earl_jax.train(..., engine="mjx")`, as `--engine mjx` on
the command line, as `engine = "mjx"` in the options of a sweep's grid, and in the adapters. `reset` and `step` are pure
functions of one lane. The program of a step contains no callback and no foreign call.
"""

# %%
env = earl_jax.make(TASK, engine="mjx", eval_horizon=HORIZON)
state = jax.eval_shape(env.reset, jax.random.key(0))
program = str(jax.make_jaxpr(env.step)(state, jnp.zeros(env.action_size)))
print(env)
print("callbacks:", program.count("callback"), " foreign calls:", program.count("ffi_call"))

# %% [markdown]
"""
## Beside the C engine

The same lanes take the same random actions on both engines. They agree to rounding at first; contacts and
time amplify the difference. The times are those of this machine (stored with the page: two CPU cores shared
with other work): of a whole scan of control steps, without compilation, and of the first call, with it.
"""


# %%
def roll_out(env, key, lanes, steps):
    """Return joint positions [steps, lanes, nq] under random actions."""
    start_key, action_key = jax.random.split(key)
    states = jax.vmap(env.reset)(jax.random.split(start_key, lanes))
    actions = jax.random.uniform(action_key, (steps, lanes, env.action_size), minval=-1.0, maxval=1.0)

    def step(states, actions):
        states = jax.vmap(env.step)(states, actions)
        return states, states.data.qpos

    return jax.lax.scan(step, states, actions)[1]


def timed(function, *arguments):
    """Return the result and the seconds of a call."""
    start = time.perf_counter()
    return jax.block_until_ready(function(*arguments)), time.perf_counter() - start


LANES, LENGTH = (2, 5) if TINY else (8, 50)
paths, rows = {}, ["| engine | first call, s | a control step of all lanes, ms |", "| --- | --- | --- |"]
for engine in ("mjx", "c"):
    task = earl_jax.make(TASK, engine=engine)
    play = jax.jit(lambda key, task=task: roll_out(task, key, LANES, LENGTH))
    _, first = timed(play, jax.random.key(0))
    paths[engine], seconds = timed(play, jax.random.key(0))
    rows.append(f"| `{engine}` | {first:.1f} | {1e3 * seconds / LENGTH:.2f} |")
Markdown("\n".join(rows))

# %%
gap = np.abs(np.asarray(paths["mjx"]) - np.asarray(paths["c"])).max(axis=(1, 2))
plt.semilogy(1 + np.arange(LENGTH), np.maximum(gap, 1e-9), color="C1")
plt.xlabel("control step")
plt.ylabel("largest difference of a joint (m, rad)")
plt.show()

# %% [markdown]
"""
## A sweep in one program

`earl_jax.lifetime` is a whole training run as a pure function. A `Problem` holds what is static, so plain
`jax.jit` takes it as an argument. Methods are pytrees: `vmap` over a learning rate is a sweep. The area under
the deployed curve and its interval over seeds are computed on the device too, so only finished numbers leave
the program. `auto` would train this page's task on the C engine; `envs.for_lanes` shows its choice.
"""

# %%
protocol = earl_jax.Protocol(env.train_horizon, HORIZON, eval_every=EVERY, eval_episodes=2)
problem = earl_jax.Problem(env, protocol, steps=STEPS)
method = earl_jax.method_for(env, "naive", random_steps=RANDOM_STEPS, timeout_bootstrap=True, **NETWORK)
keys = jax.random.split(jax.random.key(0), SEEDS)
evaluated = np.arange(EVERY, STEPS + 1, EVERY)
print("auto takes:", earl_jax.envs.for_lanes(earl_jax.make(TASK), len(RATES) * SEEDS).engine)


@jax.jit
def sweep(problem, rates, keys):
    """Return deployed returns [rates, seeds, evaluations], and the summary over seeds of their areas, [rates] each."""

    def run(rate):
        chosen = method.replace(learner=method.learner.replace(learning_rate=rate))
        _, metrics = earl_jax.lifetime(problem, chosen, keys)
        returns = metrics["deployed/return"]
        return returns, summarise(deployed_area(evaluated, returns))

    return jax.vmap(run)(rates)


(curves, summary), seconds = timed(sweep, problem, jnp.array(RATES), keys)
print(f"{len(RATES) * SEEDS} lifetimes of {STEPS:,} steps: {seconds:.0f} s, compilation included")

# %%
for number, rate in enumerate(RATES):
    mean = np.asarray(curves[number]).mean(axis=0)
    label = f"{rate:g}: IQM {summary.iqm[number]:.1f} [{summary.low[number]:.1f}, {summary.high[number]:.1f}]"
    plt.plot(evaluated, mean, color=f"C{number}", label=label)
step_axis(plt.gca())
plt.ylabel("deployed return")
plt.legend(title="learning rate: mean height of the curve")
plt.show()

# %% [markdown]
"""
## A run folder

`train` compiles the same steps in chunks, with logs and checkpoints between them. The run records its engine
in `config.json`, the command line prints it, and `Result.engine` has it.
"""

# %%
result = earl_jax.train(
    env, method, engine="mjx", seeds=SEEDS, steps=EVERY, eval_every=EVERY, eval_episodes=2, out=RUNS / "fish"
)
print(result.engine, result.metrics["deployed/return"][:, -1])
