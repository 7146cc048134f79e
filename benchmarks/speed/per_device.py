"""Measure programs that share a GPU through MPS: `python -m benchmarks.speed.per_device --cases sawyer_door:fbrl:1,2,4`.

A case is TASK:METHOD[,METHOD...]:K[,K...]. For each K, as many programs run at once, each with its own cores; with several
methods, they take turns, and K = 1 measures each method alone. All programs of a case start and compile first, and rates are
those of the seconds in which all of a measurement run. `gain` is the throughput of the programs at once over that of one after
the other: the sum of each one's rate over its rate alone. `wall_gain` is the time of equally many steps of each, one after the
other, over the time until the last of them is ready at the rates measured: the smaller of the two.

Prints a line for each measurement, and rows for earl_jax/sweeps/slots.py; writes OUT.json and OUT.csv. Without a GPU,
programs share the cores.
"""

import contextlib
import dataclasses
import json
import os
import statistics
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import tyro

from benchmarks.output import RESULTS, save_rows
from earl_jax.cli.xla_flags import helpful_flags
from earl_jax.options.environment import FRACTION, own_cores
from earl_jax.sweeps.mps import mps
from earl_jax.sweeps.slots import Slot, make_slots, visible_gpus

WORKER = "benchmarks.speed.per_device_worker"


@dataclasses.dataclass(frozen=True)
class Options:
    """What to measure."""

    cases: tuple[str, ...] = ("sawyer_door:fbrl:1,2,4",)
    """TASK:METHODS:KS."""
    lanes: int = 5
    seconds: float = 5.0
    """Seconds of each measurement."""
    rounds: int = 2
    """Rounds of all measurements of a case; rates are their means."""
    chunk: int = 1000
    """Steps in a call of the program."""
    compile_at_once: int = 4
    set: tuple[str, ...] = ("precision=bf16",)
    """name=value options of the method."""
    out: Path = RESULTS / "per_device" / "run"


class Case(NamedTuple):
    """Programs of one task: their `algos` and the numbers of programs at once to measure."""

    env: str
    algos: tuple[str, ...]
    counts: tuple[int, ...]

    @classmethod
    def parse(cls, text: str) -> "Case":
        env, algos, counts = text.split(":")
        return cls(env, tuple(algos.split(",")), tuple(sorted({1, *map(int, counts.split(","))})))

    def programs(self) -> list[tuple[str, ...]]:
        """Return the methods that run at once in each measurement; each method alone comes first."""
        together = [
            tuple(self.algos[index % len(self.algos)] for index in range(count)) for count in self.counts if count > 1
        ]
        return [(algo,) for algo in self.algos] + together


class Program:
    """A worker that trains one method on one task when it is asked to."""

    def __init__(self, env: str, algo: str, slot: Slot, variables: dict[str, str], options: Options):
        sizes = ["--lanes", str(options.lanes), "--chunk", str(options.chunk), "--cores", *map(str, slot.cores)]
        command = [sys.executable, "-m", WORKER, env, algo, *sizes, "--set", *options.set]
        environment = slot.environment({**os.environ, **variables})
        flags = [os.environ.get("XLA_FLAGS", ""), *helpful_flags(os.environ)]
        environment |= {
            "XLA_FLAGS": " ".join(flags).strip(),
            "XLA_PYTHON_CLIENT_PREALLOCATE": "false",  # idle programs of other measurements have their share too
            FRACTION: "0.9",
        }
        self.algo = algo
        self._process = subprocess.Popen(
            command, env=environment, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )

    def reply(self) -> dict[str, Any]:
        """Return the next message of the worker."""
        assert self._process.stdout is not None
        for line in self._process.stdout:
            if line.startswith("{"):
                return json.loads(line)
            print(line, end="", file=sys.stderr)
        raise RuntimeError(f"the program of {self.algo} ended with code {self._process.wait()}")

    def run(self, seconds: float) -> None:
        """Let the worker train for `seconds`; its reply has the rate."""
        assert self._process.stdin is not None
        self._process.stdin.write(f"{seconds}\n")
        self._process.stdin.flush()

    def end(self) -> None:
        self._process.kill()
        self._process.wait()


def compile_programs(cases: Sequence[Case], options: Options, gpus: list[str]) -> None:
    """Compile every program once, `--compile-at-once` at a time, so that all later processes load it."""
    waiting = list(dict.fromkeys((case.env, algo) for case in cases for algo in case.algos))
    slots = make_slots(options.compile_at_once, gpus, own_cores())
    while waiting:
        batch, waiting = waiting[: len(slots)], waiting[len(slots) :]
        programs = [Program(env, algo, slot, {}, options) for (env, algo), slot in zip(batch, slots, strict=False)]
        for (env, algo), program in zip(batch, programs, strict=True):
            try:
                print(f"{env} {algo}: compiled in {program.reply()['compile_s']} s", flush=True)
            except RuntimeError as error:
                print(f"{env} {algo}: {error}", flush=True)
        for program in programs:
            program.end()


def measure(case: Case, options: Options, gpus: list[str], variables: dict[str, str]) -> list[dict[str, Any]]:
    """Return a row for each number of programs of `case`; all programs are ready before the first measurement."""
    groups: list[tuple[list[Program], Slot]] = []
    try:
        for algos in case.programs():
            slots = make_slots(len(algos), gpus, own_cores())
            shared = variables if len(algos) > 1 else {}
            programs = [Program(case.env, algo, slot, shared, options) for algo, slot in zip(algos, slots, strict=True)]
            groups.append((programs, slots[0]))
        for program in (program for programs, _ in groups for program in programs):
            program.reply()
        return _rows(case, groups, options.seconds, options.rounds)
    finally:
        for program in (program for programs, _ in groups for program in programs):
            program.end()


def _rates(programs: Sequence[Program], seconds: float) -> list[float]:
    """Return the rates of programs that train at once."""
    for program in programs:
        program.run(seconds)
    return [program.reply()["steps_per_s"] for program in programs]


def _rows(case: Case, groups: list[tuple[list[Program], Slot]], seconds: float, count: int) -> list[dict[str, Any]]:
    alone: dict[str, float] = {}
    rows = []
    rounds = [[_rates(programs, seconds) for programs, _ in groups] for _ in range(count)]
    for index, (programs, slot) in enumerate(groups):
        rates = [statistics.mean(values) for values in zip(*(measured[index] for measured in rounds), strict=True)]
        if len(programs) == 1:
            alone[programs[0].algo] = rates[0]
        before = [alone[program.algo] for program in programs]
        rows.append({
            "env": case.env, "algos": "+".join(program.algo for program in programs), "programs": len(programs),
            "cores_each": len(slot.cores), "steps_per_s_each": " ".join(f"{rate:.0f}" for rate in rates),
            "steps_per_s_total": round(sum(rates), 1),
            "gain": round(sum(rate / one for rate, one in zip(rates, before, strict=True)), 3),
            "wall_gain": round(sum(1 / one for one in before) * min(rates), 3),
        })  # fmt: skip
        print(rows[-1], flush=True)
    return rows


def table_rows(rows: Sequence[dict[str, Any]]) -> list[str]:
    """Return the rows of several programs as lines of the table in earl_jax/sweeps/slots.py."""
    tasks: dict[str, dict[tuple[int, int], float]] = {}
    for row in rows:
        if row["programs"] > 1:
            tasks.setdefault(row["env"], {}).setdefault((row["programs"], row["cores_each"]), row["wall_gain"])
    return [f'    "{env}": {gains},' for env, gains in tasks.items()]


def main(options: Options) -> None:
    """Measure all cases."""
    cases, gpus = [Case.parse(text) for text in options.cases], visible_gpus(os.environ)[:1]
    began, rows = time.monotonic(), []
    with mps() if gpus else contextlib.nullcontext({}) as variables:
        print(
            f"GPU: {gpus[0] if gpus else 'none'}; cores: {len(own_cores())}; MPS: {'on' if gpus else 'off'}", flush=True
        )
        compile_programs(cases, options, gpus)
        for case in cases:
            try:
                rows += measure(case, options, gpus, variables)
            except RuntimeError as error:
                print(f"{case.env}: {error}", flush=True)
                continue
            print(f"{time.monotonic() - began:.0f} s since the start", flush=True)
            save_rows(options.out, rows)
    print("rows for earl_jax/sweeps/slots.py:", *table_rows(rows), sep="\n")


if __name__ == "__main__":
    main(tyro.cli(Options, description=__doc__))
