"""An experiment as data, and the folder it lives in: config.json, metrics.csv, checkpoints."""

import contextlib
import csv
import dataclasses
import json
import numbers
import os
import uuid
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from earl_jax.algos import Method, make_algo
from earl_jax.devices import first_host
from earl_jax.envs import Env, make
from earl_jax.files import LOCK, PART, inside, locked, write_atomically
from earl_jax.protocol import Deployment, Protocol, Setting, setting_of, settled
from earl_jax.provenance import provenance

CONFIG, METRICS, CHECKPOINTS = "config.json", "metrics.csv", "checkpoints"
LEFTOVERS = (LOCK, CONFIG + PART)
"""What a kill in the moment of making a folder leaves there."""
Row = dict[str, float]


@dataclasses.dataclass(frozen=True)
class Experiment:
    """All that is needed to repeat a run: names, options that differ from the defaults, seeds and lengths."""

    env: str
    env_options: dict[str, Any]
    algo: str
    options: dict[str, Any]
    seeds: tuple[int, ...]
    steps: int
    eval_every: int
    eval_episodes: int
    checkpoint_every: int
    setting: dict[str, Any] = dataclasses.field(default_factory=lambda: {"name": Deployment.name})
    """The name of the setting, and those of its options that differ from the defaults."""

    def __post_init__(self):
        kinds = {"env": str, "env_options": dict, "algo": str, "options": dict, "setting": dict}
        for field, kind in kinds.items():
            if not isinstance(getattr(self, field), kind):
                raise ValueError(f"{field} must be a {kind.__name__}, not {getattr(self, field)!r}")
        if "name" not in self.setting:
            raise ValueError(f"setting has no name: {self.setting}")
        whole = [self.steps, self.eval_every, self.eval_episodes, self.checkpoint_every, *self.seeds]
        if any(isinstance(number, bool) or not isinstance(number, numbers.Integral) for number in whole):
            raise ValueError(f"seeds, steps and what is counted in them are whole numbers, not {whole}")
        if not self.seeds or len(set(self.seeds)) < len(self.seeds):
            raise ValueError(f"seeds must be at least one and distinct, not {list(self.seeds)}")
        if min(self.seeds) < 0 or max(self.seeds) >= 2**32:
            raise ValueError(f"seeds must lie in 0 to 2**32 - 1, not {list(self.seeds)}")
        for field in ("steps", "eval_every", "eval_episodes", "checkpoint_every"):
            if getattr(self, field) < 1:
                raise ValueError(f"{field} must be at least 1, not {getattr(self, field)}")
        if self.steps % self.eval_every:
            raise ValueError(f"steps {self.steps} is not a multiple of eval_every {self.eval_every}")

    @classmethod
    def of(
        cls,
        env: Env,
        method: Method,
        seeds: Sequence[int],
        steps: int,
        every: int,
        episodes: int,
        checkpoint_every: int,
        setting: Setting | None = None,
    ) -> "Experiment":
        """Return the experiment of built objects; `every` is shortened to `steps` where a run is shorter than that."""
        task, setting = settled(env, setting or Deployment())
        return cls(
            task.name, _changed(task), method.name, method_options(method), tuple(seeds), steps, min(every, steps), episodes,
            checkpoint_every, {"name": setting.name, **_changed(setting)},
        )  # fmt: skip

    def build_setting(self) -> Setting:
        """Return what the life is for and what may touch it."""
        return setting_of(**self.setting)

    def build_env(self) -> Env:
        """Return the world: the task, with help where the setting has a budget for it."""
        return self.build_setting().world(make(self.env, **self.env_options))

    @property
    def deployed_metric(self) -> str:
        """What the task is judged by: deployed success where rewards are sparse, return where they are dense."""
        return "deployed/success" if self.build_env().sparse else "deployed/return"

    def build_method(self) -> Method:
        """Return the method with its hyper-parameters."""
        return make_algo(self.algo, **self.options)

    def protocol(self, env: Env) -> Protocol:
        """Return the protocol: the task's horizons, the setting's rules, this run's evaluations."""
        return self.build_setting().protocol(env, self.eval_every, self.eval_episodes)

    def checkpoint_due(self, step: int) -> bool:
        """Return whether a checkpoint follows the evaluation at `step`: at least `checkpoint_every` apart, and at the end."""
        passed = step // self.checkpoint_every > (step - self.eval_every) // self.checkpoint_every
        return passed or step == self.steps

    def rows(self, step: int, metrics: dict[str, np.ndarray]) -> list[Row]:
        """Return one row a seed of `metrics [N]`."""
        return [
            {"step": step, "seed": seed, **{name: values[i].item() for name, values in metrics.items()}}
            for i, seed in enumerate(self.seeds)
        ]

    def curves(self, rows: list[Row]) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        """Return evaluation steps [E] and metrics [N, E] of `rows`."""
        steps = np.array(sorted({int(row["step"]) for row in rows}))
        if not rows:
            return steps, {}
        names = [name for name in rows[0] if name not in ("step", "seed")]
        table = {(int(row["step"]), int(row["seed"])): row for row in rows}
        return steps, {
            name: np.array([[table[step, seed][name] for step in steps.tolist()] for seed in self.seeds])
            for name in names
        }


def _changed(options: Any) -> dict[str, Any]:
    """Return the fields of a dataclass that differ from its defaults."""
    fields = {field.name: field.default for field in dataclasses.fields(options)}
    return {name: getattr(options, name) for name, default in fields.items() if getattr(options, name) != default}


def method_options(method: Method) -> dict[str, Any]:
    """Return the hyper-parameters of `method` that differ from its class's defaults, as plain values."""
    default, options = type(method)(), {}
    for one, other in ((method.sac, default.sac), (method, default)):
        for field in dataclasses.fields(one):
            value = getattr(one, field.name)
            plain = np.asarray(value).tolist() if hasattr(value, "shape") else value
            if field.name != "sac" and plain != getattr(other, field.name):
                options[field.name] = plain
    return options


@dataclasses.dataclass(frozen=True)
class RunFolder:
    """A folder that belongs to one experiment."""

    path: Path
    experiment: Experiment
    logs: tuple[str, ...] = ()
    """Where else its metrics go, names of `logs.LOGS`."""

    @property
    def metrics(self) -> Path:
        """The table: a row per seed and evaluation."""
        return self.path / METRICS

    @property
    def checkpoints(self) -> Path:
        """The folder of checkpoints, named by step."""
        return self.path / CHECKPOINTS

    @property
    def config(self) -> Path:
        """The experiment, and what else a repetition would want to know."""
        return self.path / CONFIG

    @property
    def id(self) -> str:
        """A name that no other run has, the same after the folder has moved."""
        return json.loads(self.config.read_text())["id"]

    @classmethod
    def create(cls, path: Path, experiment: Experiment, logs: Sequence[str] = ()) -> "RunFolder":
        """Return a new run folder with its config.json; a folder that holds anything is refused and left alone."""
        if (path / CONFIG).is_file():
            raise ValueError(f"{path} holds another run; choose another folder, or go on with: earl-jax resume {path}")
        if path.exists() and (not path.is_dir() or any(entry.name not in LEFTOVERS for entry in path.iterdir())):
            raise ValueError(f"{path} exists and is not an empty folder; choose another")
        told = {
            "id": uuid.uuid4().hex,
            "engine": experiment.build_env().engine,
            "logs": list(logs),
            "provenance": provenance(),
        }
        path.mkdir(parents=True, exist_ok=True)
        folder = cls(path, experiment, tuple(logs))
        with folder.claimed():
            if folder.config.is_file():
                raise ValueError(f"{path} holds another run that another process has just begun; choose another folder")
            write_atomically(folder.config, json.dumps({**dataclasses.asdict(experiment), **told}, indent=2) + "\n")
        return folder

    @classmethod
    def open(cls, path: Path) -> "RunFolder":
        """Return the run folder at `path`.

        Raises:
            ValueError: its config is missing, unreadable or of no experiment, or something in it leads out of the folder.
        """
        file = path / CONFIG
        if not file.is_file():
            raise ValueError(f"{path} is no run folder: it has no {CONFIG}")
        for name in (CONFIG, METRICS, CHECKPOINTS):
            inside(path, name)
        try:
            config = json.loads(file.read_text())
            known = [field.name for field in dataclasses.fields(Experiment) if field.name in config]
            experiment = Experiment(**{**{name: config[name] for name in known}, "seeds": tuple(config["seeds"])})
            return cls(path, experiment, tuple(map(str, config.get("logs", ()))))
        except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
            told = str(error) if type(error) is ValueError else repr(error)
            raise ValueError(f"{file} is damaged: {told}") from error

    @contextlib.contextmanager
    def claimed(self) -> Iterator[None]:
        """Give this folder to this process alone: of several hosts the first one stands for all.

        Raises:
            ValueError: another process is writing here.
            OSError: nothing can be written here.
        """
        with locked(self.path) if first_host() else contextlib.nullcontext():
            yield

    def extended(self, steps: int) -> "RunFolder":
        """Return the same folder with its experiment made `steps` long; one that has lived longer is refused."""
        lived = max((int(row["step"]) for row in self.rows()), default=0)
        if steps < lived:
            raise ValueError(f"{self.path} has lived {lived} steps already, more than {steps}")
        longer = dataclasses.replace(self.experiment, steps=steps)
        if first_host():
            with self.claimed():
                config = json.loads(self.config.read_text())
                write_atomically(self.config, json.dumps({**config, "steps": steps}, indent=2) + "\n")
        return dataclasses.replace(self, experiment=longer)

    def append(self, rows: list[Row]) -> None:
        """Add rows to metrics.csv and see them on the disk."""
        try:
            new = not self.metrics.exists() or not self.metrics.stat().st_size
            with self.metrics.open("a", newline="") as handle:
                writer = csv.DictWriter(handle, rows[0], lineterminator="\n")
                if new:
                    writer.writeheader()
                writer.writerows(rows)
                handle.flush()
                os.fsync(handle.fileno())
        except OSError as error:
            cause, then = error.strerror or error, f"earl-jax resume {self.path} goes on from the last checkpoint"
            raise OSError(f"{self.metrics} can't be written: {cause}; {then}") from error

    def _lines(self) -> list[str]:
        """Return the whole lines of metrics.csv, header first; one that a kill cut short is left out."""
        text = self.metrics.read_bytes().decode(errors="replace") if self.metrics.exists() else ""
        return [line for line in text.splitlines(keepends=True) if line.endswith("\n")]

    def rows(self) -> list[Row]:
        """Return the whole rows of metrics.csv; one that is not of numbers is a ValueError that names its line."""
        found = []
        for number, row in enumerate(csv.DictReader(self._lines()), 2):
            try:
                found.append(_row(row))
            except (ValueError, AttributeError):
                raise ValueError(f"{self.metrics} is damaged: line {number} is not a row of numbers") from None
        return found

    def rows_until(self, step: int) -> list[Row]:
        """Drop rows later than `step`, which a resumed run writes again, and return the rest."""
        rows, lines = self.rows(), self._lines()
        kept = [line for line, row in zip(lines[1:], rows, strict=True) if row["step"] <= step]
        text = "".join(lines[:1] + kept) if kept else ""
        if self.metrics.exists() and self.metrics.read_bytes() != text.encode():
            write_atomically(self.metrics, text)
        return rows[: len(kept)]


def _row(texts: dict[str, str]) -> Row:
    row = {name: _number(text) for name, text in texts.items()}
    if not {"step", "seed"} <= set(row):
        raise ValueError("no step or no seed")
    return row


def _number(text: str) -> float:
    return int(text) if text.lstrip("-").isdigit() else float(text)
