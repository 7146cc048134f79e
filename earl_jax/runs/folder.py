"""The folder of a run: config.json, metrics.csv, policies.npz and checkpoints."""

import contextlib
import dataclasses
import itertools
import json
import os
import shlex
import sys
import uuid
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from earl_jax.errors import InputError, brief
from earl_jax.options.imports import records, resume_command
from earl_jax.options.jax_settings import recorded_settings, require_settings
from earl_jax.runs import contents
from earl_jax.runs.checkpoint import newest, saved_steps, try_out
from earl_jax.runs.config import RunConfig
from earl_jax.runs.contents import CHECKPOINTS, CONFIG, METRICS, POLICIES
from earl_jax.runs.files import append, check_folder, locked, read_bytes, warn, write_atomically
from earl_jax.runs.hosts import first_host
from earl_jax.runs.provenance import changed_versions, provenance
from earl_jax.runs.table import COLUMNS, Table, columns_of, csv_text, whole_lines

FORMAT = 3
"""The format of config.json, which the file names."""
LARGEST_CONFIG = 1 << 24
"""Bytes of a config.json."""


@dataclasses.dataclass(frozen=True)
class RunFolder:
    """A folder that belongs to one run."""

    path: Path
    config: RunConfig
    logs: tuple[str, ...] = ()
    """Additional logs of the run's metrics, names in `logging.LOGS`."""

    def __fspath__(self) -> str:
        return str(self.path)

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
        identifier = self.recorded().get("id")
        if not isinstance(identifier, str):
            raise InputError(f"{self.config_file} is damaged: it has no id")
        return identifier

    @classmethod
    def create(
        cls, path: Path, config: RunConfig, engine: str, logs: Sequence[str] = (), overwrite: bool = False
    ) -> "RunFolder":
        """Return a new run folder with its config.json; `engine` is the physics engine that the run uses.

        A folder in which a run started and left no results is used again. With `overwrite`, so is one with results,
        which are removed; a line on stderr names them.

        Raises:
            ValueError: the folder holds another run's results or other files, and is left unchanged, or the config has
                options that JSON cannot represent.
        """
        _require_free(path, overwrite)  # before its lock is written
        text = _config_text(config, engine, logs)
        try:
            path.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise OSError(f"{path} can't be created: {error.strerror}; choose another folder") from error
        folder = cls(path, config, tuple(logs))
        with folder._locked():
            _require_free(path, overwrite)
            has_results = contents.has_results(path)
            removed = contents.clear(path)
            if has_results:
                print(f"earl-jax: removed from the earlier run in {path}: {', '.join(removed)}", file=sys.stderr)
            write_atomically(folder.config_file, text)
        return folder

    @classmethod
    def open(cls, path: str | Path) -> "RunFolder":
        """Return the run folder at `path`; a ValueError if its config is missing or invalid, which names runs in it."""
        if not isinstance(path, str | os.PathLike):
            raise InputError(f"a run is read from its folder, a path or Result.folder, not from {brief(path)}")
        path = Path(path)
        path = path if os.path.lexists(path / CONFIG) else Path(os.path.expanduser(path))
        file = path / CONFIG
        if not os.path.lexists(file):
            depths = ("*/", "*/*/", "*/*/*/")  # the last one is that of a sweep
            found = itertools.chain.from_iterable(path.glob(f"{depth}{CONFIG}") for depth in depths)
            inside = sorted(str(config.parent) for config in itertools.islice(found, 3))
            hint = f"; did you mean {' or '.join(inside)}?" if inside else ""
            raise InputError(f"{path.absolute()} is not a run folder: it has no {CONFIG} that can be read{hint}")
        return cls(path, *read_config(file))

    @contextlib.contextmanager
    def claimed(self) -> Iterator[None]:
        """Lock this folder for this process; if there are several hosts, the first one locks it for all.

        Raises:
            ValueError: another process has locked it or has started another run in it, or a link is where the run
                writes.
            OSError: the folder is not writable.
        """
        if not first_host():
            yield
            return
        with self._locked():
            if RunFolder.open(self.path).config.values != self.config.values:
                raise InputError(f"another process has just started another run in {self.path}; choose another folder")
            yield

    @contextlib.contextmanager
    def _locked(self) -> Iterator[None]:
        """Lock this folder, after a check that it can hold checkpoints and that a run there writes through no link."""
        with locked(self.path):
            contents.check_entries(self.path)
            try_out(self.checkpoints)
            yield

    def record(self, **values: Any) -> None:
        """Write entries of config.json, such as the physics engine that trains this run, unless they are there.

        Files that are imported in this process, and were not when the run began, are added to its `imports`.
        """
        present = self.recorded()
        known = present.get("imports", [])
        if added := [record for record in records() if record not in known]:
            values["imports"] = [*known, *added]
        if not values.items() <= present.items():
            write_atomically(self.config_file, json.dumps({**present, **values}, indent=2) + "\n")

    def recorded(self) -> dict[str, Any]:
        """Return the entries of config.json, with the engine and the provenance."""
        return json.loads(read_bytes(self.config_file, LARGEST_CONFIG))

    def append(self, step: int, metrics: Mapping[str, np.ndarray]) -> None:
        """Append the rows of `metrics [N]` to metrics.csv, in the columns that it has, and flush them to the disk."""
        try:
            append(self.metrics, csv_text(step, self.config.seeds, metrics, columns_of(self.metrics)))
        except OSError as error:
            remedy = f"{resume_command(self.path)} continues from the last checkpoint"
            raise OSError(f"{self.metrics} can't be written: {error.strerror or error}; {remedy}") from error

    def table(self) -> Table:
        """Return the table of metrics, up to its last complete evaluation. A `RunWarning` says that later rows are not read.

        Raises:
            ValueError: a row is damaged, repeated, missing or of another run, or the newest checkpoint comes after the
                last row; the message says what to do.
        """
        step = newest(self.checkpoints)  # before the table, because a running process writes the rows first
        table = self._table(step, whole=True)
        if table.cut:
            cause = "after it a seed or the end of a line is missing"
            warn(f"{self.metrics} is read up to its last whole evaluation, of step {table.step:,}: {cause}")
        return table

    def require_resumable(self) -> Table:
        """Return the table of metrics, whose rows and columns up to the newest checkpoint are intact.

        A `RunWarning` names the files of the run that have changed.

        Raises:
            ValueError: jax has other settings here, or, as `table`, a row or a column is damaged or missing.
        """
        require_same_settings(self.config_file)
        self.config.warn_of_changes(self.path)
        step = newest(self.checkpoints)
        table = self._table(step)
        missing = sorted(COLUMNS.difference(table.metrics))
        if missing and table.step and step:
            problem = f"it has no column {', '.join(missing)}; restore the file from a copy"
            raise InputError(f"{self.metrics} is damaged: {problem}")
        return table

    def table_until(self, step: int) -> Table:
        """Drop the rows after `step`, which a resumed run writes again, and return the table of the others. Errors as `table`."""
        table = self._table(step).until(step)
        count = len(table.steps) * len(self.config.seeds)
        if self.metrics.exists():
            write_atomically(self.metrics, "".join(itertools.islice(whole_lines(self.metrics), count and count + 1)))
        return table

    def _table(self, step: int, whole: bool = False) -> Table:
        """Return the table of metrics; raise an InputError unless its rows up to `step`, or its `whole`, are intact."""
        if step > self.config.steps:
            name = f"{CHECKPOINTS}/{step:09d}"
            raise InputError(
                f"{self.path} is damaged: {name} is later than the {self.config.steps} steps of {CONFIG}; restore "
                f"{CONFIG}, or delete {name}"
            )
        table = Table.read(self.metrics, self.config)
        if table.problem and (whole or table.step < step):
            raise self._damaged(table, table.problem)
        if table.step < step // self.config.eval_every * self.config.eval_every:
            problem = f"its rows end at step {table.step}, but the newest checkpoint is of step {step}"
            raise self._damaged(table, problem)
        return table

    def _damaged(self, table: Table, problem: str) -> InputError:
        """Return the error of a `problem`, with what to do if only the rows of `table` are intact."""
        steps = saved_steps(self.checkpoints)
        later = [f"{CHECKPOINTS}/{step:09d}" for step in steps if step > table.step]
        step = max((step for step in steps if step <= table.step), default=0)
        remedy = f"{resume_command(self.path)} continues from step {step} and writes later rows again"
        if later or not step:
            start = f"train again with: earl-jax train --config {shlex.quote(str(self.path))} --out NEW"
            remedy = f"delete {' and '.join(later)} to resume from step {step}" if step else start
            remedy = f"restore the file from a copy, or {remedy}"
        return InputError(f"{self.metrics} is damaged: {problem}; {remedy}")


def _require_free(path: Path, overwrite: bool) -> None:
    """Raise an InputError if the folder at `path` holds results, unless `overwrite`, or files that are not a run's."""
    check_folder(path)
    if not isinstance(overwrite, bool):
        raise InputError(f"overwrite must be True or False, not {brief(overwrite)}")
    in_the_way = contents.has_results(path) and not overwrite
    if in_the_way and contents.is_run(path):
        raise InputError(
            f"{path} holds another run; choose another folder, read it with earl_jax.load({str(path)!r}), continue it with: "
            f"{resume_command(path)}, or replace it with --overwrite (in Python, overwrite=True)"
        )
    unknown = contents.unknown_entries(path)
    if unknown or in_the_way:
        names = ", ".join(unknown[:5]) or "results without a config.json"
        raise InputError(
            f"{path} exists and is not an empty folder: it holds {names}; move it away, or choose another folder"
        )


def read_config(file: Path) -> tuple[RunConfig, tuple[str, ...]]:
    """Return the config in `file`, a config.json, and the names of the run's logs; a ValueError says what is invalid."""
    fault = "is damaged"
    try:
        values = json.loads(read_bytes(file, LARGEST_CONFIG))
        if (known := values.get("format", ...)) != FORMAT:
            if isinstance(known, int):
                fault = "was written by another version of earl_jax"
            named = f"its format is {brief(known)}" if "format" in values else "it names no format"
            raise InputError(f"{named}, and this version of earl_jax reads {FORMAT}")
        for name in ("seeds", "logs"):
            if not isinstance(values.get(name, []), list):
                raise InputError(f"{name} must be a list")
        return RunConfig.from_stored(values), tuple(map(str, values.get("logs", ())))
    except KeyError as error:
        raise InputError(f"{file} is damaged: it has no {error}") from error
    except (ValueError, TypeError, AttributeError, RecursionError) as error:
        cause = str(error) if isinstance(error, InputError) else f"{type(error).__name__}: {error}"
        raise InputError(f"{file} {fault}: {cause}") from error


def require_same_settings(file: Path) -> None:
    """Raise a ValueError if a setting of jax that changes numbers is not that of the run of `file`, a valid config.json.

    A `RunWarning` names the packages with other versions, which can change them too.
    """
    recorded = json.loads(read_bytes(file, LARGEST_CONFIG))
    require_settings(recorded.get("jax", {}), str(file))
    if changed := changed_versions(recorded.get("provenance")):
        warn(f"the run began with {changed}, which can change its numbers")


def _config_text(config: RunConfig, engine: str, logs: Sequence[str]) -> str:
    """Return the text of config.json."""
    more = {"id": uuid.uuid4().hex, "engine": engine, "logs": list(logs)}
    more |= {"jax": recorded_settings(), "provenance": provenance()}
    try:
        return json.dumps({"format": FORMAT, **dataclasses.asdict(config), **more}, indent=2) + "\n"
    except TypeError as error:
        raise InputError(
            f"the options of {config.env} or {config.algo} can't be written to {CONFIG} ({error}); "
            "train without a folder, or pass them as numbers, text and lists"
        ) from error
