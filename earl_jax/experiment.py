"""An experiment as data, and the folder it lives in: config.json, metrics.csv, checkpoints."""

import csv
import dataclasses
import json
import os
import platform
import subprocess
from collections.abc import Sequence
from importlib import metadata
from pathlib import Path
from typing import Any

import jax
import numpy as np

from earl_jax.algos import Method, make_algo
from earl_jax.envs import Env, make
from earl_jax.protocol import Deployment, Protocol, Setting, setting_of, settled

PACKAGES = ("earl-jax", "jax", "jaxlib", "flax", "optax", "orbax-checkpoint", "brax", "mujoco", "mujoco-mjx", "numpy")
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


def provenance() -> dict[str, Any]:
    """Return what else a repetition would want to know: versions, platform, commit."""
    versions = {}
    for package in PACKAGES:
        try:
            versions[package] = metadata.version(package)
        except metadata.PackageNotFoundError:
            versions[package] = None
    return {
        "versions": versions,
        "python": platform.python_version(),
        "backend": jax.default_backend(),
        "device": jax.devices()[0].device_kind,
        "commit": _commit(),
    }


def _commit() -> str | None:
    """Return the commit of the checkout this package runs from, or None from a wheel."""
    here = Path(__file__).resolve().parent
    command = ["git", "-C", str(here), "log", "-1", "--format=%H", "--", str(here)]
    try:
        return subprocess.run(command, capture_output=True, text=True, timeout=10).stdout.strip() or None
    except (OSError, subprocess.TimeoutExpired):
        return None


@dataclasses.dataclass(frozen=True)
class RunFolder:
    """A folder that belongs to one experiment."""

    path: Path
    experiment: Experiment

    @property
    def metrics(self) -> Path:
        """The table: a row per seed and evaluation."""
        return self.path / "metrics.csv"

    @property
    def checkpoints(self) -> Path:
        """The folder of checkpoints, named by step."""
        return self.path / "checkpoints"

    @classmethod
    def create(cls, path: Path, experiment: Experiment) -> "RunFolder":
        """Return a new run folder with its config.json; a folder that holds anything is refused and left alone."""
        if (path / "config.json").is_file():
            raise ValueError(f"{path} holds another run; choose another folder, or go on with: earl-jax resume {path}")
        if path.exists() and (not path.is_dir() or any(path.iterdir())):
            raise ValueError(f"{path} exists and is not an empty folder; choose another")
        path.mkdir(parents=True, exist_ok=True)
        config = {**dataclasses.asdict(experiment), "engine": experiment.build_env().engine, "provenance": provenance()}
        write_atomically(path / "config.json", json.dumps(config, indent=2) + "\n")
        return cls(path, experiment)

    @classmethod
    def open(cls, path: Path) -> "RunFolder":
        """Return the run folder at `path`; a missing or unreadable config is a ValueError that says what is wrong."""
        file = path / "config.json"
        if not file.is_file():
            raise ValueError(f"{path} is no run folder: it has no config.json")
        try:
            config = json.loads(file.read_text())
            fields = {
                field.name: config[field.name] for field in dataclasses.fields(Experiment) if field.name in config
            }
            return cls(path, Experiment(**{**fields, "seeds": tuple(fields["seeds"])}))
        except (json.JSONDecodeError, KeyError, TypeError) as error:
            raise ValueError(f"{file} is damaged: {error!r}") from error

    def extended(self, steps: int) -> "RunFolder":
        """Return the same folder with its experiment made `steps` long; one that has lived longer is refused."""
        lived = max((int(row["step"]) for row in self.rows()), default=0)
        if steps < lived:
            raise ValueError(f"{self.path} has lived {lived} steps already, more than {steps}")
        longer = dataclasses.replace(self.experiment, steps=steps)
        config = json.loads((self.path / "config.json").read_text())
        if jax.process_index() == 0:
            write_atomically(self.path / "config.json", json.dumps({**config, "steps": steps}, indent=2) + "\n")
        return RunFolder(self.path, longer)

    def append(self, rows: list[Row]) -> None:
        """Add rows to metrics.csv and see them on the disk."""
        new = not self.metrics.exists() or not self.metrics.stat().st_size
        with self.metrics.open("a", newline="") as handle:
            writer = csv.DictWriter(handle, rows[0], lineterminator="\n")
            if new:
                writer.writeheader()
            writer.writerows(rows)
            handle.flush()
            os.fsync(handle.fileno())

    def _lines(self) -> list[str]:
        """Return the whole lines of metrics.csv, header first; one that a kill cut short is left out."""
        text = self.metrics.read_bytes().decode() if self.metrics.exists() else ""
        return [line for line in text.splitlines(keepends=True) if line.endswith("\n")]

    def rows(self) -> list[Row]:
        """Return the whole rows of metrics.csv."""
        return [{name: _number(text) for name, text in row.items()} for row in csv.DictReader(self._lines())]

    def rows_until(self, step: int) -> list[Row]:
        """Drop rows later than `step`, which a resumed run writes again, and return the rest."""
        lines = self._lines()
        kept = [line for line in lines[1:] if int(line.split(",", 1)[0]) <= step]
        if self.metrics.exists():
            write_atomically(self.metrics, "".join(lines[:1] + kept) if kept else "")
        return self.rows()


def _number(text: str) -> float:
    return int(text) if text.lstrip("-").isdigit() else float(text)


def write_atomically(path: Path, text: str) -> None:
    """Write `text` to `path` so that a kill leaves either the old file or the new one."""
    part = path.with_name(path.name + ".part")
    with part.open("w") as handle:
        handle.write(text)
        handle.flush()
        os.fsync(handle.fileno())
    part.replace(path)
