"""Gradient steps a second of SAC alone, by precision and way of writing bf16: `python -m benchmarks.update --out FILE`.

Prints the card's ceilings (large products, a large copy), a row a bf16 variant at the first of `--lanes` with the
share of both ceilings it reaches, kernel tables of the first two, how far the fastest is from float32, its rows at the
other lanes, and tf32's. Writes FILE.json and FILE.csv after every row; a variant that fails is a row with its error.
"""

import argparse
import dataclasses
import functools
import statistics
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from unittest import mock

import jax
import jax.numpy as jnp

from benchmarks.output import save
from earl_jax.algos import networks
from earl_jax.algos import sac as sac_lib
from earl_jax.algos.networks import WAYS, Ways
from earl_jax.algos.sac import SAC, Agent, Batch
from earl_jax.report.tables import write

OBS, ACTION, CRITICS, POOL = 14, 4, 2, 2048
"""Sizes of the Sawyer door; batches are windows of `POOL` random transitions a lane."""
SIZE = 8192


@dataclasses.dataclass(frozen=True)
class Variant:
    """One way to run the update."""

    label: str
    precision: str
    ways: Ways = WAYS


BASE, GUESS, USUAL = (
    Variant("bf16 autodiff", "bf16", Ways(False, *WAYS[1:])._replace(spread=False)),
    Variant("bf16", "bf16"),
    Variant("tf32", "tf32"),
)


def variants() -> list[Variant]:
    """Return those of bf16: the base, the guess, then the guess with one choice the other way round."""
    choices = {name: not value for name, value in WAYS._asdict().items() if name != "hand"}
    flipped = [
        Variant(f"bf16 {'with' if value else 'without'} {name}", "bf16", WAYS._replace(**{name: value}))
        for name, value in choices.items()
    ]
    return [BASE, GUESS, *flipped]


def timed(call: Callable[[], Any], repeats: int, flight: int = 1) -> float:
    """Return the median seconds of `call`, `flight` of them sent before waiting, after some that don't count."""
    times = []
    for _ in range(repeats + 1):
        began = time.perf_counter()
        jax.block_until_ready([call() for _ in range(flight)])
        times.append((time.perf_counter() - began) / flight)
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
    """Return operations and least bytes of one update of one lane: parameters, moments and targets once each way."""
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
def world(lanes: int) -> tuple[Agent, Batch, jax.Array]:
    """Return agents, pools of random transitions [lanes, POOL, ...] and keys."""
    keys = jax.random.split(jax.random.key(0), lanes)
    agents = jax.jit(jax.vmap(lambda key: sac_lib.init(key, SAC(), OBS, ACTION, CRITICS)))(keys)
    parts = jax.random.split(jax.random.key(1), 5)
    shape = (lanes, POOL)
    pool = Batch(
        jax.random.normal(parts[0], (*shape, OBS)),
        jax.random.uniform(parts[1], (*shape, ACTION), minval=-1, maxval=1),
        jax.random.normal(parts[2], shape),
        jax.random.bernoulli(parts[3], 0.1, shape),
        jax.random.normal(parts[4], (*shape, OBS)),
    )
    return agents, pool, keys


def program(sac: SAC, lanes: int, steps: int) -> tuple[Callable, tuple]:
    """Return the compiled scan of `steps` updates of all lanes, which overwrites its agents, and its arguments."""
    agents, pool, keys = world(lanes)
    agents = jax.jit(functools.partial(jax.tree.map, jnp.copy))(agents)

    def step(agents, number, pool, keys):
        start = number * 64 % (POOL - sac.batch_size)
        batch = jax.tree.map(lambda leaf: jax.lax.dynamic_slice_in_dim(leaf, start, sac.batch_size, 1), pool)
        fresh = jax.vmap(jax.random.fold_in, (0, None))(keys, number)
        return jax.vmap(functools.partial(sac_lib.update, sac))(agents, batch, fresh)

    def run(agents, pool, keys):
        agents, said = jax.lax.scan(lambda a, i: step(a, i, pool, keys), agents, jnp.arange(steps))
        return agents, jax.tree.map(lambda leaf: leaf[-1].mean(), said)

    return jax.jit(run, donate_argnums=0).lower(agents, pool, keys).compile(), (agents, pool, keys)


def measure(
    variant: Variant, lanes: int, repeats: int, limits: dict[str, float], look: bool
) -> tuple[dict, list[dict]]:
    """Return one variant's row, steps a second and how much of the ceilings they take, and its kernels if to `look`."""
    steps = max(2, min(200, 20_000 // lanes)) if jax.default_backend() == "gpu" else 4
    sac = SAC(precision=variant.precision)
    jax.clear_caches()
    with mock.patch.object(networks, "WAYS", variant.ways):
        began = time.perf_counter()
        run, (agents, *rest) = program(sac, lanes, steps)
        compiled = time.perf_counter() - began
    state = [agents]

    def call():
        state[0], said = run(state[0], *rest)
        return said

    pace = steps / timed(call, repeats)
    flops, least = cost(sac, CRITICS)
    rate, traffic = pace * lanes * flops / 1e12, pace * lanes * least / 1e9
    row = {
        "variant": variant.label, "lanes": lanes, "compile_s": round(compiled, 1), "steps_per_s": round(pace, 1),
        "lane_steps_per_s": round(pace * lanes), "tflops": round(rate, 2),
        "of_matmul": round(rate / limits[variant.precision], 4), "of_copy": round(traffic / limits["copy"], 4),
        "critic_loss": float(call()["critic_loss"]), "error": "",
    }  # fmt: skip
    return row, kernels(variant.label, lanes, steps, call) if look else []


def kernels(label: str, lanes: int, steps: int, call: Callable[[], Any]) -> list[dict[str, Any]]:
    """Return microseconds a step and launches of the 25 dearest kernels of `call`, after their sums over all."""
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
        return {"variant": label, "lanes": lanes, "kernel": name[:90], **each}

    dearest = sorted(spent.items(), key=lambda item: -sum(item[1]))[:25]
    return [row("all", [one for times in spent.values() for one in times]), *[row(*item) for item in dearest]]


def errors(variant: Variant, tiny: bool) -> Iterator[dict[str, Any]]:
    """Yield the relative error norms of outputs and gradients against float32, for a critic and an actor."""
    batch, hidden, lanes = (32, 64, 2) if tiny else (256, 256, 8)
    for name, inputs, outputs in (("critic", OBS + ACTION, 1), ("actor", OBS, 2 * ACTION)):
        network = networks.mlp((hidden, hidden), outputs)
        keys = jax.random.split(jax.random.key(2), (lanes, CRITICS))
        params = jax.vmap(jax.vmap(lambda key, n=network, k=inputs: n.init(key, jnp.zeros(k))))(keys)
        x = jax.random.normal(jax.random.key(3), (lanes, batch, inputs))
        weight = jax.random.normal(jax.random.key(4), (lanes, CRITICS, batch, outputs))

        def results(variant, network=network, params=params, x=x, weight=weight):
            def everything(params, x):
                one = functools.partial(networks.apply, network, precision=variant.precision)
                out, pull = jax.vjp(jax.vmap(jax.vmap(one, (0, None))), params, x)
                return out, *pull(weight)

            jax.clear_caches()
            with mock.patch.object(networks, "WAYS", variant.ways):
                return jax.jit(everything)(params, x)

        right = results(Variant("float32", "float32"))
        off = jax.tree.map(lambda a, b: float(jnp.linalg.norm(a - b) / jnp.linalg.norm(b)), results(variant), right)
        layers = {f"{k}/{p}": round(v, 5) for k, layer in off[1]["params"].items() for p, v in layer.items()}
        whole = {"outputs": round(off[0], 5), "x": round(off[2], 5)}
        yield {"network": name, "variant": variant.label, **whole, **layers}


def _brief(error: Exception) -> str:
    return f"{type(error).__name__}: " + " | ".join(str(error).splitlines()[:3])[:400]


class Report:
    """Prints rows and writes all so far, so that a run that is cut short leaves what it had."""

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
    """Measure every bf16 variant at the first number of lanes, then the fastest and tf32 at the others."""

    def attempt(variant, count, look=False):
        if time.perf_counter() > deadline:
            return 0.0
        try:
            row, table = measure(variant, count, repeats, limits, look)
        except Exception as error:
            names = ("compile_s", "steps_per_s", "lane_steps_per_s", "tflops", "of_matmul", "of_copy", "critic_loss")
            row, table = {"variant": variant.label, "lanes": count, **dict.fromkeys(names), "error": _brief(error)}, []
        report.add("rows", row)
        report.add("kernels", *table)
        return row["steps_per_s"] or 0.0

    paces = {variant: attempt(variant, lanes[0], variant in (BASE, GUESS)) for variant in variants()}
    fastest = max(paces, key=paces.__getitem__)
    if time.perf_counter() < deadline:
        report.add("errors", *errors(fastest, tiny=jax.default_backend() != "gpu"))
    for variant, counts in ((fastest, lanes[1:]), (USUAL, lanes)):
        for count in counts:
            attempt(variant, count)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--lanes", type=int, nargs="+", default=[50, 5, 500])
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--seconds", type=float, default=95, help="start no variant later than this")
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results/update/run"))
    arguments = parser.parse_args()
    deadline = time.perf_counter() + arguments.seconds
    report = Report(arguments.out, f"python -m benchmarks.update --lanes {' '.join(map(str, arguments.lanes))}")
    limits = ceilings()
    flops, least = cost(SAC(), CRITICS)
    report.add("ceilings", limits)
    report.add("update", {"flops": flops, "least_bytes": least})
    compare(report, arguments.lanes, arguments.repeats, limits, deadline)


if __name__ == "__main__":
    main()
