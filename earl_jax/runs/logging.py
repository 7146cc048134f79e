"""Logs of a run: always metrics.csv, and TensorBoard or Weights & Biases on request.

All of them receive the same `log(step, metrics)`. metrics.csv is the record: after a kill, a run goes on from its last
checkpoint, drops the rows after it and writes them again, on a CPU bit for bit. TensorBoard purges what came after the
checkpoint. Weights & Biases continues the same run, where the first value of a step counts.
"""

import dataclasses
import importlib
import os
from collections.abc import Callable, Sequence
from typing import Any, Protocol

import numpy as np

from earl_jax.runs.folder import RunFolder


class Log(Protocol):
    """A receiver of metrics: any object with these two methods."""

    def log(self, step: int, metrics: dict[str, np.ndarray]) -> None:
        """Take the metrics of an evaluation at `step`: arrays [N], a value a seed."""
        ...

    def close(self) -> None:
        """End, with everything written."""
        ...


class CSVLog:
    """The table of the run folder: a row a seed and evaluation."""

    def __init__(self, folder: RunFolder):
        self._folder = folder

    def log(self, step: int, metrics: dict[str, np.ndarray]) -> None:
        """Add the rows of `step` to metrics.csv, on the disk when this returns."""
        self._folder.append(self._folder.config.rows(step, metrics))

    def close(self) -> None:
        """Do nothing: every row is on the disk already."""


def scalars(seeds: Sequence[int], metrics: dict[str, np.ndarray]) -> dict[str, float]:
    """Return the mean over `seeds` of every metric [N] under its name, and each seed's value under `name/seed_K`."""
    values_by_name: dict[str, float] = {}
    for name, values in metrics.items():
        values_by_name[name] = float(np.mean(values))
        values_by_name.update({f"{name}/seed_{seed}": float(value) for seed, value in zip(seeds, values, strict=True)})
    return values_by_name


class TensorBoardLog:
    """Event files in the folder `tensorboard` of a run folder."""

    def __init__(self, folder: RunFolder, since: int):
        try:
            from tensorboardX import SummaryWriter
        except ImportError as error:
            raise ValueError("the log tensorboard needs tensorboardX: pip install 'earl-jax[tensorboard]'") from error
        self._seeds = folder.config.seeds
        place, forget = str(folder.path / "tensorboard"), since + 1 if since else None
        own = f".{since}.{os.getpid()}"  # tensorboardX names files by the second, which may repeat
        self._writer = SummaryWriter(place, purge_step=forget, filename_suffix=own)

    def log(self, step: int, metrics: dict[str, np.ndarray]) -> None:
        """Write a scalar for every mean and every seed."""
        for name, value in scalars(self._seeds, metrics).items():
            self._writer.add_scalar(name, value, step)
        self._writer.flush()

    def close(self) -> None:
        """Close the event file."""
        self._writer.close()


class WandbLog:
    """A run of Weights & Biases, offline where WANDB_MODE says so; a resumed run folder goes on with the same one."""

    def __init__(self, folder: RunFolder, since: int):
        del since  # wandb resumes the run by itself
        try:
            wandb: Any = importlib.import_module("wandb")
        except ImportError as error:
            raise ValueError("the log wandb needs wandb: pip install 'earl-jax[wandb]'") from error
        config = folder.config
        try:
            self._run = wandb.init(
                project="earl_jax", name=folder.path.name, group=f"{config.env}/{config.algo}", id=folder.id,
                config=dataclasses.asdict(config), dir=str(folder.path), resume="allow", reinit="create_new",
            )  # fmt: skip
        except wandb.Error as error:
            raise ValueError(f"wandb: {error}; WANDB_MODE=offline needs no account") from error
        self._seeds = config.seeds

    def log(self, step: int, metrics: dict[str, np.ndarray]) -> None:
        """Write all means and all seeds as one row of history."""
        self._run.log(scalars(self._seeds, metrics), step=step)

    def close(self) -> None:
        """Finish the run."""
        self._run.finish()


LOGS: dict[str, Callable[[RunFolder, int], Log]] = {"tensorboard": TensorBoardLog, "wandb": WandbLog}


def check_logs(names: Sequence[Any]) -> None:
    """Raise a ValueError for a log that is neither one of `LOGS` nor an object with `log` and `close`."""
    for name in names:
        if isinstance(name, str) and name not in LOGS:
            raise ValueError(f"unknown log {name!r}; choose from {', '.join(LOGS)}")
        if not isinstance(name, str) and not (hasattr(name, "log") and hasattr(name, "close")):
            raise ValueError(f"{name!r} is no log: that has log(step, metrics) and close()")


def open_logs(folder: RunFolder | None, others: Sequence[Log], since: int) -> list[Log]:
    """Return every log of a run that goes on from step `since`: its folder's, then `others`."""
    if folder is None:
        return list(others)
    return [CSVLog(folder), *(LOGS[name](folder, since) for name in folder.logs), *others]
