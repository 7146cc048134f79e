"""Measure what each method costs beside naive RL, in steps/s: `python -m benchmarks.speed.method_cost --minutes 5`.

The programs of all methods, of `--chunk` training steps, are compiled first, `--threads` at a time. With `--wait-for PATH`,
timing starts when that file exists, so that other work can use the device until then. In each round every method runs for about
`--seconds`, and a ratio is to naive's rate in the same round; the first round does not count. Evaluations and the cloning
before the first step are not timed. Writes results/method_cost/NAME.{csv,json} after each round (NAME is the device unless
`--name` gives one), and at the end the tables of docs/methods.md from all of these files; with `--table` only the tables.
"""

import dataclasses
import os
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import jax
import numpy as np
import tyro

from benchmarks.output import RESULTS, pages_with, read_csv, save_rows, write_files
from benchmarks.speed.training import compile_steps, make_training
from earl_jax.cli.arguments import parse_options
from earl_jax.cli.xla_flags import set_flags
from earl_jax.options.environment import own_cores
from earl_jax.report.tables import Row, markdown_table

ROOT = RESULTS / "method_cost"
METHODS = (
    "naive", "oracle", "fbrl", "fbrl controllers=1", "r3l", "vaprl", "bc", "risc", "medal", "rlpd", "rlpd utd=20", "cfbrl",
)  # fmt: skip
"""Methods, each with options as `--set` takes them; the others are compared with the first."""
HEADER = ("method", "steps/s", "speed relative to the first")


@dataclasses.dataclass(frozen=True)
class Options:
    """What to measure."""

    env: str = "tabletop_organization"
    methods: tuple[str, ...] = METHODS
    """Methods with options; the first is compared with."""
    lanes: int = 5
    set: tuple[str, ...] = ("precision=bf16",)
    """name=value options of all methods."""
    minutes: float = 5
    """Start no round later than this after the first."""
    rounds: int = 20
    seconds: float = 0.7
    """Seconds of a measurement, which is at least one chunk."""
    chunk: int = 1000
    """Steps of a call, as in training by default."""
    steps: int = 1_000_000
    """Rows of a replay, which end the measurement."""
    threads: int = len(own_cores())
    wait_for: Path | None = None
    """Start timing when this file exists."""
    name: str | None = None
    """Name of the files written; by default the device."""
    table: bool = False
    """Write the tables alone, from the kept files."""


class Program:
    """The compiled chunk of the method `name`; its replay has space for `room` more steps."""

    def __init__(self, name: str, options: Options):
        algo, *own = name.split()
        choices = parse_options(options.set) | parse_options(own)
        problem, self._method, self._state = make_training(options.env, algo, options.lanes, options.steps, **choices)
        _, self._program, seconds = compile_steps(problem, self._method, [self._state], options.chunk)
        self.name, self.room, self._chunk, self._calls = name, options.steps, options.chunk, 1
        print(f"{name}: compiled in {seconds:.1f} s", flush=True)

    def fit(self, seconds: float) -> None:
        """Let a measurement take about `seconds`, by the second of two chunks."""
        self.rate()
        self._calls = max(1, round(seconds * self.rate() / self._chunk))

    def rate(self) -> float:
        """Return steps per second of the next chunks."""
        steps, began = self._calls * self._chunk, time.perf_counter()
        for _ in range(self._calls):
            self._state = self._program(self._method, self._state)
        jax.block_until_ready(self._state.step)
        self.room -= steps
        return steps / (time.perf_counter() - began)

    @property
    def full(self) -> bool:
        """Whether the replay has no space for another measurement."""
        return self.room < self._calls * self._chunk


def compile_programs(options: Options) -> list[Program]:
    """Return the programs of the methods; one that does not compile is left out, but the first must."""

    def attempt(name: str) -> Program | None:
        try:
            return Program(name, options)
        except Exception as error:
            if name == options.methods[0]:
                raise
            print(f"{name} is left out: {type(error).__name__}: {str(error)[:400]}", flush=True)
            return None

    with ThreadPoolExecutor(options.threads) as pool:
        return [program for program in pool.map(attempt, options.methods) if program]


def measure(programs: Sequence[Program], options: Options, out: Path) -> None:
    """Time the programs in turns, in every second round from the last to the first, and write the results so far."""
    for program in programs:
        program.fit(options.seconds)
    rates: dict[str, list[float]] = {program.name: [] for program in programs}
    end = time.monotonic() + 60 * options.minutes
    for number in range(options.rounds + 1):
        if time.monotonic() > end or any(program.full for program in programs):
            return
        timed = {program.name: program.rate() for program in programs[:: -1 if number % 2 else 1]}
        if number > 0:
            for name, rate in timed.items():
                rates[name].append(rate)
            write_result(rates, options, out)
            print(f"round {number}:", *(f"{name} {rate[-1]:.0f}" for name, rate in rates.items()), sep="  ", flush=True)


def write_result(rates: dict[str, list[float]], options: Options, out: Path) -> None:
    """Write rates, rows, flags and provenance to `out`.json, and the rows to `out`.csv."""
    setting = {
        "device": jax.devices()[0].device_kind, "cores": len(own_cores()), "env": options.env, "lanes": options.lanes,
        "set": " ".join(options.set),
    }  # fmt: skip
    rows = [setting | row for row in cost_rows(rates)]
    save_rows(out, rows, xla_flags=os.environ.get("XLA_FLAGS", ""), rates=rates)


def cost_rows(rates: dict[str, list[float]]) -> list[Row]:
    """Return a row for each method: median and quartiles of its `rates`, and of their ratios to the first method's."""
    rows, base = [], np.array(next(iter(rates.values())))
    for name, values in rates.items():
        method, *own = name.split()
        row: Row = {"method": method, "options": " ".join(own), "rounds": len(values)}
        for column, sample in (("steps_per_s", np.array(values)), ("ratio", values / base)):
            low, median, high = np.percentile(sample, (25, 50, 75)).round(4).tolist()
            row |= {column: median, f"{column}_low": low, f"{column}_high": high}
        rows.append(row)
    return rows


def tables(root: Path = ROOT) -> str:
    """Return a markdown table of medians with its heading for each csv file in `root`."""
    return "\n\n".join(map(_table, sorted(root.glob("*.csv")))) or "No device has been measured in this way yet."


def _table(path: Path) -> str:
    rows = read_csv(path)
    heading = "{device} with {cores} cores, {env}, {lanes} lanes, `{set}`, {rounds} rounds:".format(**rows[0])
    shown = (0, 2) if rows[0]["device"] == "cpu" else range(len(HEADER))  # of a CPU only ratios
    lines = [[cells[column] for column in shown] for cells in (HEADER, *map(_line, rows))]
    return f"{heading}\n\n{markdown_table(lines[0], lines[1:])}"


def _line(row: dict[str, str]) -> list[str]:
    name = f"`{row['method']}`" + f", `{row['options']}`" * bool(row["options"])
    return [name, f"{float(row['steps_per_s']):,.0f}", f"{float(row['ratio']):.3g}"]


def files() -> dict[Path, str]:
    """Return the page with the tables of the kept files."""
    return pages_with({"method cost": tables()})


def main(options: Options) -> None:
    """Measure, and write the tables."""
    if not options.table:
        set_flags(["train"])  # the flags of a GPU that training has
        os.environ.setdefault("XLA_PYTHON_CLIENT_PREALLOCATE", "false")  # while compiling, leave the memory to others
        programs = compile_programs(options)
        print("all programs are compiled", flush=True)
        while options.wait_for and not options.wait_for.exists():
            time.sleep(0.2)
        device = jax.devices()[0].device_kind.lower().removeprefix("nvidia ").replace(" ", "_")
        measure(programs, options, ROOT / (options.name or device))
    write_files(files())


if __name__ == "__main__":
    main(tyro.cli(Options, description=__doc__))
