"""Measure gradient steps per second of SAC alone, by precision: `python -m benchmarks.update --out FILE`.

Prints the device's ceilings (large products, a large copy), a row for every precision and number of lanes with its share of both
ceilings, kernel tables, and errors of tf32 and bf16 against float32. Writes FILE.json and FILE.csv after every row. A run that
fails is a row with its error.
"""

import argparse
import functools
import itertools
import statistics
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp

from benchmarks.output import save
from earl_jax.algos.learner import networks
from earl_jax.algos.learner import sac as sac_lib
from earl_jax.algos.learner.sac import SAC, Agent, Batch
from earl_jax.report.tables import write

OBS, ACTION, CRITICS, POOL = 14, 4, 2, 2048
"""Sizes of the Sawyer door; batches are windows of `POOL` random transitions a lane."""
SIZE = 8192


COMPARED = ("tf32", "bf16")
"""Precisions whose kernels and errors are reported."""


def timed(call: Callable[[], Any], repeats: int, at_once: int = 1) -> float:
    """Return the median seconds of `call`, with `at_once` calls dispatched before waiting, after some untimed calls."""
    times = []
    for _ in range(repeats + 1):
        began = time.perf_counter()
        jax.block_until_ready([call() for _ in range(at_once)])
        times.append((time.perf_counter() - began) / at_once)
    return statistics.median(times[1:])


def ceilings() -> dict[str, float]:
    """Return the rates of one large product, by precision, and of one large copy on this device."""
    gpu = jax.default_backend() == "gpu"
    size, report = SIZE if gpu else 1024, {}
    keys = jax.random.split(jax.random.key(0))
    for precision, dtype, lax_precision in (
        ("bf16", jnp.bfloat16, None), ("tf32", jnp.float32, None), ("float32", jnp.float32, "highest"),
    ):  # fmt: skip
        a, b = [jax.random.normal(key, (size, size), dtype) for key in keys]
        product = jax.jit(functools.partial(jnp.matmul, precision=lax_precision))
        report[precision] = 2 * size**3 / timed(functools.partial(product, a, b), 5, 10) / 1e12
    block = jnp.ones((2**29 if gpu else 2**24,), jnp.float32)
    copy = jax.jit(lambda x: x + 1)
    report["copy"] = 2 * block.nbytes / timed(lambda: copy(block), 5, 10) / 1e9
    return report


def cost(sac: SAC, critics: int) -> tuple[float, float]:
    """Return operations and least bytes of one update of one lane: parameters, moments and targets read and written once."""
    batch, hidden = sac.batch_size, sac.hidden_sizes[0]

    def net(inputs, outputs):
        first, inner = 2 * batch * inputs * hidden, 2 * batch * hidden * (hidden + outputs)
        return first + inner, inner, (inputs + 1) * hidden + (hidden + 1) * hidden + (hidden + 1) * outputs

    actor, actor_inner, actor_size = net(OBS, 2 * ACTION)
    critic, critic_inner, critic_size = net(OBS + ACTION, 1)
    flops = 3 * actor + actor_inner + critics * (3 * critic + critic_inner) + 2 * 2 * critic
    numbers = 6 * (actor_size + critics * critic_size) + 2 * critics * critic_size
    return flops, 4.0 * (numbers + batch * (2 * OBS + ACTION + 2))


@functools.cache
def make_agents(lanes: int) -> tuple[Agent, Batch, jax.Array]:
    """Return agents, pools of random transitions [lanes, POOL, ...] and keys."""
    keys = jax.random.split(jax.random.key(0), lanes)
    agents = jax.jit(jax.vmap(lambda key: sac_lib.init(key, SAC(), OBS, ACTION, CRITICS)))(keys)
    parts = jax.random.split(jax.random.key(1), 5)
    shape = (lanes, POOL)
    pool = Batch(
        obs=jax.random.normal(parts[0], (*shape, OBS)),
        action=jax.random.uniform(parts[1], (*shape, ACTION), minval=-1, maxval=1),
        reward=jax.random.normal(parts[2], shape),
        terminal=jax.random.bernoulli(parts[3], 0.1, shape),
        next_obs=jax.random.normal(parts[4], (*shape, OBS)),
    )
    return agents, pool, keys


def program(sac: SAC, lanes: int, steps: int) -> tuple[Callable, tuple]:
    """Return the compiled scan of `steps` updates of all lanes, which overwrites its agents, and its arguments."""
    agents, pool, keys = make_agents(lanes)
    agents = jax.jit(functools.partial(jax.tree.map, jnp.copy))(agents)

    def step(agents, number, pool, keys):
        start = number * 64 % (POOL - sac.batch_size)
        batch = jax.tree.map(lambda leaf: jax.lax.dynamic_slice_in_dim(leaf, start, sac.batch_size, 1), pool)
        fresh = jax.vmap(jax.random.fold_in, (0, None))(keys, number)
        return jax.vmap(functools.partial(sac_lib.update, sac))(agents, batch, fresh)

    def run(agents, pool, keys):
        agents, diagnostics = jax.lax.scan(lambda a, i: step(a, i, pool, keys), agents, jnp.arange(steps))
        return agents, jax.tree.map(lambda leaf: leaf[-1].mean(), diagnostics)

    return jax.jit(run, donate_argnums=0).lower(agents, pool, keys).compile(), (agents, pool, keys)


def measure(
    precision: str, lanes: int, repeats: int, limits: dict[str, float], profile: bool
) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """Return the row of a precision, with its rate and share of the ceilings, and with `profile` its kernels."""
    steps = max(2, min(200, 20_000 // lanes)) if jax.default_backend() == "gpu" else 4
    sac = SAC(precision=precision)
    began = time.perf_counter()
    run, (agents, *rest) = program(sac, lanes, steps)
    compiled = time.perf_counter() - began
    state = [agents]

    def call():
        state[0], diagnostics = run(state[0], *rest)
        return diagnostics

    step_rate = steps / timed(call, repeats)
    flops, least = cost(sac, CRITICS)
    rate, traffic = step_rate * lanes * flops / 1e12, step_rate * lanes * least / 1e9
    row = {
        "precision": precision, "lanes": lanes, "compile_s": round(compiled, 1), "steps_per_s": round(step_rate, 1),
        "lane_steps_per_s": round(step_rate * lanes), "tflops": round(rate, 2),
        "of_matmul": round(rate / limits[precision], 4), "of_copy": round(traffic / limits["copy"], 4),
        "critic_loss": float(call()["critic_loss"]), "error": "",
    }  # fmt: skip
    return row, kernels(precision, lanes, steps, call) if profile else []


def kernels(precision: str, lanes: int, steps: int, call: Callable[[], Any]) -> list[dict[str, Any]]:
    """Return microseconds per step and launches of the 25 slowest kernels of `call`, after a row with the sums of all."""
    spent: dict[str, list[float]] = defaultdict(list)
    with tempfile.TemporaryDirectory() as folder:
        with jax.profiler.trace(folder):
            jax.block_until_ready(call())
        for file in Path(folder).rglob("*.xplane.pb"):
            for plane in jax.profiler.ProfileData.from_file(str(file)).planes:
                for line in plane.lines if plane.name.startswith("/device:") else ():
                    for event in line.events if line.name.startswith("Stream") else ():
                        spent[event.name].append(event.duration_ns / 1e3)

    def row(name, times):
        each = {"us_per_step": round(sum(times) / steps, 2), "launches_per_step": round(len(times) / steps, 2)}
        return {"precision": precision, "lanes": lanes, "kernel": name[:90], **each}

    slowest = sorted(spent.items(), key=lambda item: -sum(item[1]))[:25]
    return [row("all", list(itertools.chain(*spent.values()))), *[row(*item) for item in slowest]]


def errors(tiny: bool) -> Iterator[dict[str, Any]]:
    """Yield the relative error norms of outputs and gradients against float32, for critics and an actor's network."""
    batch, hidden, lanes = (32, 64, 2) if tiny else (256, 256, 8)
    for kind, inputs, outputs in (("critic", OBS + ACTION, 1), ("actor", OBS, 2 * ACTION)):
        network = networks.mlp((hidden, hidden), outputs)
        keys = jax.random.split(jax.random.key(2), (lanes, CRITICS))
        params = jax.vmap(jax.vmap(network.init, (0, None)), (0, None))(keys, jnp.zeros(inputs))
        x = jax.random.normal(jax.random.key(3), (lanes, batch, inputs))
        weight = jax.random.normal(jax.random.key(4), (lanes, CRITICS, batch, outputs))

        def results(params, x, precision, network=network, weight=weight):
            apply = functools.partial(networks.apply, network, precision=precision)
            out, pull = jax.vjp(jax.vmap(jax.vmap(apply, (0, None))), params, x)
            return out, *pull(weight)

        precisions = ("float32", *COMPARED)
        by_precision = {name: jax.jit(functools.partial(results, precision=name))(params, x) for name in precisions}
        for precision in COMPARED:
            pair = by_precision[precision], by_precision["float32"]
            error = jax.tree.map(lambda a, b: round(float(jnp.linalg.norm(a - b) / jnp.linalg.norm(b)), 5), *pair)
            layers = {f"{k}/{p}": value for k, layer in error[1]["params"].items() for p, value in layer.items()}
            yield {"network": kind, "precision": precision, "outputs": error[0], "x": error[2], **layers}


def _brief(error: Exception) -> str:
    return f"{type(error).__name__}: " + " | ".join(str(error).splitlines()[:3])[:400]


class Report:
    """Prints rows and writes all of them so far, so that an interrupted run keeps its rows."""

    def __init__(self, out: Path, command: str):
        self.out, self.command, self.parts = out, command, defaultdict(list)

    def add(self, part: str, *rows: dict[str, Any]) -> None:
        for row in rows:
            self.parts[part].append(row)
            print(row, flush=True)
        save(self.out.with_suffix(".json"), self.command, dict(self.parts))
        if part == "rows":
            write(self.parts["rows"], self.out.with_suffix(".csv"))


def compare(report: Report, lanes: list[int], repeats: int, limits: dict[str, float], deadline: float) -> None:
    """Measure every precision at every number of lanes, and profile `COMPARED` at the first number."""
    for count, precision in itertools.product(lanes, reversed(networks.PRECISIONS)):
        if time.perf_counter() > deadline:
            return
        try:
            profile = count == lanes[0] and precision in COMPARED
            row, table = measure(precision, count, repeats, limits, profile)
        except Exception as error:
            names = ("compile_s", "steps_per_s", "lane_steps_per_s", "tflops", "of_matmul", "of_copy", "critic_loss")
            row, table = {"precision": precision, "lanes": count, **dict.fromkeys(names), "error": _brief(error)}, []
        report.add("rows", row)
        report.add("kernels", *table)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--lanes", type=int, nargs="+", default=[50, 5, 500])
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--seconds", type=float, default=95, help="start no row later than this")
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results/update/run"))
    arguments = parser.parse_args()
    deadline = time.perf_counter() + arguments.seconds
    report = Report(arguments.out, f"python -m benchmarks.update --lanes {' '.join(map(str, arguments.lanes))}")
    limits = ceilings()
    flops, least = cost(SAC(), CRITICS)
    report.add("ceilings", limits)
    report.add("update", {"flops": flops, "least_bytes": least})
    report.add("errors", *errors(tiny=jax.default_backend() != "gpu"))
    compare(report, arguments.lanes, arguments.repeats, limits, deadline)


if __name__ == "__main__":
    main()
