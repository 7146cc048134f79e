"""List the kernels of a training step as XLA compiles it for an H200, on any machine.

    python -m benchmarks.speed.kernels sawyer_door

Needs jax's CUDA packages (`pip install 'jax[cuda13]'`) but no GPU: the program is compiled ahead of time for a described one.
Prints the number of kernels in the body of the scan over steps, the length of its longest chain of kernels that wait for each
other, and with `--list` every kernel with its shape and its place in our code. A copy, a kernel before the host's call that does
not belong there, or a loop inside the step shows up here at once. Times need a GPU: `python -m benchmarks.speed.profile`.
"""

import re
from typing import Any, NamedTuple

import jax
import tyro
from jax.experimental import topologies
from tyro.conf import Positional

from earl_jax.algos import make_algo
from earl_jax.cli.arguments import parse_options
from earl_jax.envs import make
from earl_jax.physics import mjx_compat
from earl_jax.physics.engines import c
from earl_jax.protocol import Protocol
from earl_jax.training.init import init_train_state
from earl_jax.training.plan import per_lane
from earl_jax.training.scan import run_steps
from earl_jax.training.state import Problem, seed_keys

H200 = """
gpu_device_info {
  threads_per_block_limit: 1024 threads_per_warp: 32 shared_memory_per_block: 49152 shared_memory_per_core: 233472
  threads_per_core_limit: 2048 core_count: 132 fpus_per_core: 128 block_dim_limit_x: 2147483647 block_dim_limit_y: 65535
  block_dim_limit_z: 65535 memory_bandwidth: 4800000000000 l2_cache_size: 62914560 clock_rate_ghz: 1.98
  device_memory_size: 150000000000 shared_memory_per_block_optin: 232448 cuda_compute_capability { major: 9 minor: 0 }
  registers_per_core_limit: 65536 registers_per_block_limit: 65536
}
platform_name: "CUDA"
dnn_version_info { major: 9 minor: 8 }
device_description_str: "NVIDIA H200"
"""
NO_KERNEL = {"parameter", "constant", "tuple", "get-tuple-element", "bitcast", "after-all", "call"}
STEPS = 200
INSTRUCTION = re.compile(r"(?:ROOT )?%?([\w.\-]+) = (\(.*?\)|\S+) ([\w\-]+)\(([^)]*)(.*)$")
HEAD = re.compile(r"^(?:ENTRY )?%?([\w.\-]+) \(.*\) -> .*\{$")


class Kernel(NamedTuple):
    """An instruction of a compiled program that runs as a kernel, a copy or a call: its `depth` counts those it waits for."""

    name: str
    kind: str
    shape: str
    place: str
    depth: int


def compile_step(env: str, algo: str, lanes: int, **options: Any) -> str:
    """Return the optimised program, as text, of `STEPS` training steps on an H200."""
    task, method = make(env), per_lane(make_algo(algo, **options), lanes)
    problem = Problem(task, Protocol(task.train_horizon, task.eval_horizon))
    state = jax.eval_shape(lambda m, keys: init_train_state(problem, m, keys, 20_000), method, seed_keys(range(lanes)))
    for module in (jax, c, mjx_compat):  # programs differ between backends where they are traced
        module.default_backend = lambda: "gpu"
    device = topologies.get_topology_desc("1x1x1", "cuda", target_config=H200, topology="1x1x1").devices[0]
    place = jax.sharding.SingleDeviceSharding(device)
    described = jax.tree.map(lambda leaf: jax.ShapeDtypeStruct(leaf.shape, leaf.dtype, sharding=place), (method, state))
    program = jax.jit(lambda m, state: run_steps(problem, m, state, STEPS), donate_argnums=1)
    return program.trace(*described).lower(lowering_platforms=("cuda",)).compile().as_text()


def computations(text: str) -> dict[str, list[str]]:
    """Return the lines of each computation of a program by its name."""
    result: dict[str, list[str]] = {}
    lines: list[str] = []
    for line in text.splitlines():
        if head := HEAD.match(line):
            lines = result.setdefault(head.group(1), [])
        elif " = " in line:
            lines.append(line.strip())
    return result


def kernels_of(name: str, parts: dict[str, list[str]]) -> list[Kernel]:
    """Return the kernels of the computation `name`, those of the graphs that it calls included, in order."""
    depths: dict[str, int] = {}
    kernels: list[Kernel] = []
    for line in parts[name]:
        match = INSTRUCTION.match(line)
        if match is None:
            continue
        own, shape, kind, arguments, rest = match.groups()
        depth = max((depths.get(argument, 0) for argument in re.findall(r"%([\w.\-]+)", arguments)), default=0)
        if kind == "call":
            inner = kernels_of(re.search(r"to_apply=%?([\w.\-]+)", rest).group(1), parts)
            kernels += [kernel._replace(depth=kernel.depth + depth) for kernel in inner]
            depth += max((kernel.depth for kernel in inner), default=0)
        elif kind not in NO_KERNEL:
            depth += 1
            place = re.search(r'op_name="([^"]*)"', rest)
            kernels.append(
                Kernel(own, kind, shape, place.group(1).rpartition("while/body/")[2] if place else "", depth)
            )
        depths[own] = depth
    return kernels


def step_kernels(text: str) -> list[Kernel]:
    """Return the kernels of the largest loop body of a program: a training step."""
    parts = computations(text)
    bodies = re.findall(r" while\(.*body=%?([\w.\-]+)", text)
    return max((kernels_of(body, parts) for body in bodies), key=len)


def main(
    envs: Positional[tuple[str, ...]] = ("sawyer_door",),
    algo: str = "naive",
    lanes: int = 5,
    set: tuple[str, ...] = ("precision=bf16",),
    list: bool = False,
) -> None:
    """Print the kernels of each task; `set` has name=value options of the method, and with `list` every kernel is printed."""
    jax.config.update("jax_platforms", "cpu")  # the CUDA packages need no GPU to compile
    for env in envs:
        kernels = step_kernels(compile_step(env, algo, lanes, **parse_options(set)))
        copies = sum(kernel.kind == "copy" for kernel in kernels)
        longest = max(kernel.depth for kernel in kernels)
        print(f"{env} {algo}, {lanes} lanes: {len(kernels)} kernels, {copies} of them copies, longest chain {longest}")
        for kernel in kernels if list else []:
            print(f"{kernel.depth:4} {kernel.name:40} {kernel.kind:12} {kernel.shape[:60]:60} {kernel.place[-80:]}")


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
