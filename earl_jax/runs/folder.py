"""The folder of a run: config.json, metrics.csv, policies.npz, checkpoints."""

import contextlib
import csv
import dataclasses
import json
import os
import uuid
from collections.abc import Iterator, Sequence
from pathlib import Path

from earl_jax.errors import InputError
from earl_jax.runs.config import Row, RunConfig
from earl_jax.runs.files import LOCK, PART, inside, locked, write_atomically
from earl_jax.runs.hosts import first_host
from earl_jax.runs.provenance import provenance

CONFIG, METRICS, POLICIES, CHECKPOINTS = "config.json", "metrics.csv", "policies.npz", "checkpoints"
LEFTOVERS = (LOCK, CONFIG + PART)
"""Files that a kill during the creation of a folder leaves there."""


@dataclasses.dataclass(frozen=True)
class RunFolder:
    """A folder that belongs to one run."""

    path: Path
    config: RunConfig
    logs: tuple[str, ...] = ()
    """Additional logs of the run's metrics, names in `logging.LOGS`."""

    @property
    def metrics(self) -> Path:
        """The table of metrics, with a row for each seed and evaluation."""
        return self.path / METRICS

    @property
    def policies(self) -> Path:
        """The task actors of all seeds at the newest evaluation."""
        return self.path / POLICIES

    @property
    def checkpoints(self) -> Path:
        """The folder of checkpoints, named by step."""
        return self.path / CHECKPOINTS

    @property
    def config_file(self) -> Path:
        """The config file, which also records versions, commit and machine."""
        return self.path / CONFIG

    @property
    def id(self) -> str:
        """The unique identifier of the run, which does not change if the folder is moved."""
        return json.loads(self.config_file.read_text())["id"]

    @classmethod
    def create(cls, path: Path, config: RunConfig, engine: str, logs: Sequence[str] = ()) -> "RunFolder":
        """Return a new run folder with its config.json; `engine` is the physics engine that the run uses.

        Raises:
            ValueError: the folder is not empty, and is left unchanged, or the config has options that JSON cannot
                represent.
        """
        if (path / CONFIG).is_file():
            raise InputError(
                f"{path} holds another run; choose another folder, or continue it with: earl-jax resume {path}"
            )
        if path.exists() and (not path.is_dir() or any(entry.name not in LEFTOVERS for entry in path.iterdir())):
            raise InputError(f"{path} exists and is not an empty folder; choose another folder")
        text = _config_text(config, engine, logs)
        path.mkdir(parents=True, exist_ok=True)
        folder = cls(path, config, tuple(logs))
        with folder.claimed():
            if folder.config_file.is_file():
                raise InputError(
                    f"{path} holds another run, which another process has just started; choose another folder"
                )
            write_atomically(folder.config_file, text)
        return folder

    @classmethod
    def open(cls, path: Path) -> "RunFolder":
        """Return the run folder at `path`.

        Raises:
            ValueError: its config is missing or invalid, or a path in the folder points outside it.
        """
        file = path / CONFIG
        if not file.is_file():
            raise InputError(f"{path} is not a run folder: it has no {CONFIG}")
        for name in (CONFIG, METRICS, POLICIES, CHECKPOINTS):
            inside(path, name)
        try:
            values = json.loads(file.read_text())
            known = [field.name for field in dataclasses.fields(RunConfig) if field.name in values]
            config = RunConfig(**{**{name: values[name] for name in known}, "seeds": tuple(values["seeds"])})
            return cls(path, config, tuple(map(str, values.get("logs", ()))))
        except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
            cause = str(error) if isinstance(error, InputError) else repr(error)
            raise InputError(f"{file} is damaged: {cause}") from error

    @contextlib.contextmanager
    def claimed(self) -> Iterator[None]:
        """Lock this folder for this process; if there are several hosts, the first one locks it for all.

        Raises:
            ValueError: another process has locked it.
            OSError: the folder is not writable.
        """
        with locked(self.path) if first_host() else contextlib.nullcontext():
            yield

    def extended(self, steps: int) -> "RunFolder":
        """Return the same folder with a run of `steps` steps, and write the new length to config.json.

        Raises:
            ValueError: the run has more steps already.
        """
        reached = max((int(row["step"]) for row in self.rows()), default=0)
        if steps < reached:
            raise InputError(f"{self.path} has {reached} steps already, more than {steps}")
        config = dataclasses.replace(self.config, steps=steps)
        if first_host():
            with self.claimed():
                values = json.loads(self.config_file.read_text())
                write_atomically(self.config_file, json.dumps({**values, "steps": steps}, indent=2) + "\n")
        return dataclasses.replace(self, config=config)

    def append(self, rows: list[Row]) -> None:
        """Append rows to metrics.csv and flush them to the disk."""
        try:
            new = not self.metrics.exists() or not self.metrics.stat().st_size
            names = rows[0] if new else next(csv.reader(self._lines()))  # earlier versions wrote fewer metrics
            with self.metrics.open("a", newline="") as handle:
                writer = csv.DictWriter(handle, names, lineterminator="\n", extrasaction="ignore")
                if new:
                    writer.writeheader()
                writer.writerows(rows)
                handle.flush()
                os.fsync(handle.fileno())
        except OSError as error:
            cause, remedy = error.strerror or error, f"earl-jax resume {self.path} continues from the last checkpoint"
            raise OSError(f"{self.metrics} can't be written: {cause}; {remedy}") from error

    def _lines(self) -> list[str]:
        """Return the complete lines of metrics.csv, header first, without a last line that a kill truncated."""
        text = self.metrics.read_bytes().decode(errors="replace") if self.metrics.exists() else ""
        return [line for line in text.splitlines(keepends=True) if line.endswith("\n")]

    def rows(self) -> list[Row]:
        """Return the complete rows of metrics.csv.

        Raises:
            ValueError: a row has values that are not numbers; the message names its line.
        """
        rows = []
        for number, texts in enumerate(csv.DictReader(self._lines()), 2):
            try:
                rows.append(_row(texts))
            except (ValueError, AttributeError):
                raise InputError(f"{self.metrics} is damaged: line {number} is not a row of numbers") from None
        return rows

    def rows_until(self, step: int) -> list[Row]:
        """Drop the rows after `step`, which a resumed run writes again, and return the remaining ones."""
        rows, lines = self.rows(), self._lines()
        kept = [line for line, row in zip(lines[1:], rows, strict=True) if row["step"] <= step]
        text = "".join(lines[:1] + kept) if kept else ""
        if self.metrics.exists() and self.metrics.read_bytes() != text.encode():
            write_atomically(self.metrics, text)
        return rows[: len(kept)]


def _config_text(config: RunConfig, engine: str, logs: Sequence[str]) -> str:
    """Return the text of config.json."""
    more = {"id": uuid.uuid4().hex, "engine": engine, "logs": list(logs), "provenance": provenance()}
    try:
        return json.dumps({**dataclasses.asdict(config), **more}, indent=2) + "\n"
    except TypeError as error:
        raise InputError(
            f"the options of {config.env} or {config.algo} can't be written to {CONFIG} ({error}); "
            "train without a folder, or pass them as numbers, text and lists"
        ) from error


def _row(texts: dict[str, str]) -> Row:
    row = {name: _number(text) for name, text in texts.items()}
    if not {"step", "seed"} <= set(row):
        raise InputError("no step or no seed")
    return row


def _number(text: str) -> float:
    return int(text) if text.lstrip("-").isdigit() else float(text)
