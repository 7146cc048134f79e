"""Videos of a policy during training: a log that draws them and passes them on to the run's other logs."""

from collections.abc import Sequence

import numpy as np

from earl_jax.errors import InputError
from earl_jax.options.values import COUNT, require
from earl_jax.rendering.api import render
from earl_jax.rendering.output import library
from earl_jax.runs.contents import VIDEOS
from earl_jax.runs.folder import RunFolder
from earl_jax.runs.logging import OptionalLog

SIZE, FPS = (180, 240), 6.25
"""Fewer and smaller pictures than those of `render`, because training waits for them."""


class VideoLog:
    """A log that draws `count` videos of the first seed's greedy policy, spread evenly over a run's evaluations.

    The last video shows the policy at the end. Each video shows as many steps as an evaluation episode, always from the
    same start, and is written to `videos/STEP.gif` in the run folder. TensorBoard and Weights & Biases receive it, too,
    if the run logs to them. The first error becomes a warning, after which training goes on without videos.

    Raises:
        ValueError: `count` is not a number above 0, or the extra `render` is missing.
    """

    def __init__(self, count: int):
        require("videos", count, COUNT)
        library("PIL")
        self._count = count

    def attach(self, folder: RunFolder | None, logs: Sequence[OptionalLog]) -> OptionalLog:
        """Return this log for a run in `folder`, whose other `logs` receive its videos.

        Raises:
            ValueError: there is no folder.
        """
        if folder is None:
            raise InputError("videos are written into a run folder: pass one with out=")
        folder.record(**{VIDEOS: self._count})
        self._folder, self._logs = folder, logs
        return OptionalLog(VIDEOS, self)

    def log(self, step: int, metrics: dict[str, np.ndarray]) -> None:
        """Draw a video of the policies at `step` if one is due."""
        config = self._folder.config
        number, total = step // config.eval_every, config.steps // config.eval_every
        if number * self._count // total == (number - 1) * self._count // total:
            return
        path = self._folder.path / VIDEOS / f"{step:09d}.gif"
        steps = config.build_env().eval_horizon
        render(self._folder.path, path, "policy", steps=steps, size=SIZE, fps=FPS)
        for log in self._logs:
            log.show(step, f"video/seed_{config.seeds[0]}", path)

    def close(self) -> None:
        """Do nothing, because every video is written at once."""
