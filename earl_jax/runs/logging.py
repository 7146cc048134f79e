"""Logs of a run beside its metrics.csv: TensorBoard, Weights & Biases and objects, on request.

All logs receive the same `log(step, metrics)`. metrics.csv is the reference: after a kill, a run continues from its
last checkpoint, drops later rows and writes them again, on a CPU bit for bit, because the same program runs.
TensorBoard purges the events after the checkpoint. Weights & Biases continues the same run and keeps the first value of a step.
"""

import dataclasses
import importlib
import logging
import os
import struct
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from earl_jax.errors import InputError, brief, optional, require_known
from earl_jax.runs.contents import TENSORBOARD, WANDB
from earl_jax.runs.files import make_folder, warn
from earl_jax.runs.folder import RunFolder


class Log(Protocol):
    """A receiver of metrics: any object with these two methods.

    One with `attach(folder, logs)` is replaced by what that returns when training starts; `logs` are the run's others.
    """

    def log(self, step: int, metrics: dict[str, np.ndarray]) -> None:
        """Receive the metrics of an evaluation at `step`: arrays [N] with a value for each seed."""
        ...

    def close(self) -> None:
        """Close the log after all metrics are written. An error is a `RunWarning`, because the run has ended."""
        ...


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
        from tensorboardX import SummaryWriter

        # It warns of each nan, as shares of a phase that the method lacks are.
        logging.getLogger("tensorboardX.x2num").setLevel(logging.ERROR)
        self._seeds = folder.config.seeds
        make_folder(folder.path / TENSORBOARD)
        purge_step = since + 1 if since else None
        suffix = f".{since}.{os.getpid()}"  # tensorboardX names files by the second, which is not unique
        self._writer: Any = SummaryWriter(str(folder.path / TENSORBOARD), purge_step=purge_step, filename_suffix=suffix)

    def log(self, step: int, metrics: dict[str, np.ndarray]) -> None:
        """Write a scalar for every mean and every seed."""
        for name, value in scalars(self._seeds, metrics).items():
            self._writer.add_scalar(name, value, step)
        self._writer.flush()

    def show(self, step: int, name: str, file: Path) -> None:
        """Write a .gif as an image, as `add_video` does, which needs moviepy."""
        summary: Any = importlib.import_module("tensorboardX.proto.summary_pb2").Summary
        content = file.read_bytes()
        width, height = struct.unpack("<HH", content[6:10])
        image = summary.Image(height=height, width=width, colorspace=3, encoded_image_string=content)
        self._writer.file_writer.add_summary(summary(value=[summary.Value(tag=name, image=image)]), step)
        self._writer.flush()

    def close(self) -> None:
        """Close the event file."""
        self._writer.close()


class WandbLog:
    """A run of Weights & Biases, offline with WANDB_MODE=offline; a resumed run folder continues the same one."""

    def __init__(self, folder: RunFolder, since: int):
        del since  # wandb resumes the run by itself
        self._wandb: Any = importlib.import_module("wandb")
        make_folder(folder.path / WANDB)
        config = folder.config
        try:
            self._run = self._wandb.init(
                project="earl_jax", name=folder.path.name, group=f"{config.env}/{config.algo}", id=folder.id,
                config=dataclasses.asdict(config), dir=str(folder.path), resume="allow", reinit="create_new",
            )  # fmt: skip
        except Exception as error:  # wandb's own, and those of its settings and its files
            raise InputError(f"wandb: {' '.join(str(error).split())}; WANDB_MODE=offline needs no account") from error
        self._seeds = config.seeds

    def log(self, step: int, metrics: dict[str, np.ndarray]) -> None:
        """Write the means and the values of all seeds as one row of the history."""
        self._run.log(scalars(self._seeds, metrics), step=step)

    def show(self, step: int, name: str, file: Path) -> None:
        """Add a video to the row of `step`."""
        self._run.log({name: self._wandb.Video(str(file))}, step=step)

    def close(self) -> None:
        """Finish the run."""
        self._run.finish()


class OptionalLog:
    """A log without which training goes on: its first error is a `RunWarning`, after which it receives nothing more."""

    def __init__(self, name: str, log: Any):
        self._name, self._log, self._failed = name, log, False

    def log(self, step: int, metrics: dict[str, np.ndarray]) -> None:
        """Pass the metrics on."""
        self._try(self._log.log, step, metrics)

    def show(self, step: int, name: str, file: Path) -> None:
        """Pass a video on."""
        self._try(self._log.show, step, name, file)

    def close(self) -> None:
        """Close the log."""
        self._try(self._log.close)

    def _try(self, action: Callable[..., None], *arguments: Any) -> None:
        if self._failed:
            return
        try:
            action(*arguments)
        except Exception as error:
            self._failed = True
            cause = " ".join(str(error).split()) or type(error).__name__
            warn(f"the log {self._name} has failed and receives nothing more; training goes on: {cause}")


LIBRARIES = {TENSORBOARD: "tensorboardX", WANDB: "wandb"}
LOGS: dict[str, Callable[[RunFolder, int], Log]] = {TENSORBOARD: TensorBoardLog, WANDB: WandbLog}


def check_logs(logs: Sequence[Any]) -> None:
    """Raise a ValueError if a log is neither a name in `LOGS` nor an object with `log` and `close`, or lacks its library."""
    if isinstance(logs, str) or not isinstance(logs, Sequence):
        raise InputError(f"logs must be a list, such as [{TENSORBOARD!r}], not {brief(logs)}")
    for log in logs:
        if isinstance(log, str):
            require_known("log", log, LOGS)
            optional(LIBRARIES[log], f"the log {log} needs", log)
        elif isinstance(log, type) or not (hasattr(log, "log") and hasattr(log, "close")):
            raise InputError(f"{log!r} is not a log, an object with the methods log(step, metrics) and close()")


def open_logs(folder: RunFolder | None, others: Sequence[Any], since: int) -> list[Log]:
    """Return the open logs of a run that continues from step `since`: those that its folder names, then `others`."""
    named = [OptionalLog(name, LOGS[name](folder, since)) for name in dict.fromkeys(folder.logs)] if folder else []
    attached = [log.attach(folder, named) if hasattr(log, "attach") else log for log in others]
    return [*named, *attached]
