"""The place of an attack: an empty folder, copies of runs, a file outside that nothing may touch, and commands."""

import shutil
from collections.abc import Callable
from pathlib import Path

from benchmarks.attacks.case import Failure, Outcome, require
from benchmarks.attacks.process import MEMORY_MB, SECONDS, Command, forked

METRICS = "metrics.csv"
TASK = "tabletop_organization"
STEPS, EVERY = 120, 40
TINY = ("hidden_sizes=[16]", "batch_size=16", "random_steps=20")
LENGTHS = (
    "--seeds", "2", "--steps", str(STEPS), "--eval-every", str(EVERY), "--eval-episodes", "2", "--checkpoint-every", str(EVERY),
)  # fmt: skip
SECRET = "not yours\n"
OUT_OF_LINE = 1
"""Rows of metrics.csv that are not of a seed: the header."""


def train(
    folder: Path | str, *options: str, algo: str = "fbrl", task: str = TASK, more: tuple[str, ...] = ()
) -> list[str]:
    """Return the arguments of a training run of `STEPS` steps into `folder`, with `options` after --set."""
    return ["train", task, "--algo", algo, "--out", str(folder), *LENGTHS, *more, "--set", *TINY, *options]


class Place:
    """What a case works with. `baseline` holds the finished run `whole`; `path` is empty and the commands' folder."""

    def __init__(self, path: Path, baseline: Path, run: Callable[..., Outcome] | None = None):
        self.path, self._baseline, self._run = path, baseline, run
        self.outcomes: list[Outcome] = []
        self.outside = path.with_name(path.name + "-outside")
        path.mkdir(parents=True)
        self.outside.mkdir()
        (self.outside / "secret.txt").write_text(SECRET)

    @property
    def whole(self) -> bytes:
        """metrics.csv of the finished run."""
        return (self._baseline / "whole" / METRICS).read_bytes()

    def finished(self, name: str = "run") -> Path:
        """Return a copy of the finished run."""
        return shutil.copytree(self._baseline / "whole", self.path / name, symlinks=True)

    def unfinished(self, name: str = "run", step: int = STEPS - EVERY) -> Path:
        """Return a copy as a kill before the last checkpoint leaves it: with the one at `step` and no later row."""
        folder = self.finished(name)
        shutil.rmtree(folder / "checkpoints" / f"{STEPS:09d}")
        lines = (folder / METRICS).read_text().splitlines(keepends=True)
        (folder / METRICS).write_text("".join(lines[: OUT_OF_LINE + 2 * step // EVERY]))
        return folder

    def start(self, *arguments: object, before: Callable[[], object] | None = None) -> Command:
        """Return a running command in a process of its own, which calls `before` first."""

        def action() -> None:
            from earl_jax.cli.main import main

            if before is not None:
                before()
            main([str(argument) for argument in arguments])

        return forked(action, self.path)

    def run(
        self,
        *arguments: object,
        before: Callable[[], object] | None = None,
        seconds: float = SECONDS,
        memory_mb: float = MEMORY_MB,
    ) -> Outcome:
        """Return the outcome of one command, which is bounded in `seconds` and memory."""
        if self._run is not None:
            return self.note(self._run(*arguments))
        return self.note(self.start(*arguments, before=before).wait(seconds, memory_mb))

    def note(self, outcome: Outcome) -> Outcome:
        """Return `outcome`, whose time and memory count for this case."""
        self.outcomes.append(outcome)
        return outcome

    def check_outside(self) -> None:
        """Expect that the folder outside is as it was."""
        names = sorted(path.name for path in self.outside.iterdir())
        if names != ["secret.txt"] or (self.outside / "secret.txt").read_text() != SECRET:
            raise Failure(f"a file outside the run folder was written: {', '.join(names)}")

    def identical(self, outcome: Outcome, folder: Path) -> str:
        """Expect that a command succeeded and left the table of the finished run, byte for byte."""
        require(outcome.code == 0, outcome, "exit code 0 and the identical table")
        require((folder / METRICS).read_bytes() == self.whole, outcome, "a table identical to that of the finished run")
        return "finished with the identical table"

    def resumed(self, folder: Path) -> str:
        """Expect that `resume` finishes the run in `folder` with the identical table."""
        return self.identical(self.run("resume", folder), folder)
