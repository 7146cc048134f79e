"""Videos of the policies of runs for a page, each rendered once."""

import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from earl_jax.report.html.lines import Line
from earl_jax.report.scores import last_mean
from earl_jax.runs.contents import POLICIES
from earl_jax.runs.folder import RunFolder
from earl_jax.runs.policies import policies_step

SECONDS = 6.0
"""Length of a video: one episode or a few."""
SIZE, FPS = (240, 320), 12.5


class Film(NamedTuple):
    """A video of the policy of one seed of a run, or why there is none."""

    file: Path | None
    caption: str
    cause: str = ""


class PolicyVideos:
    """Renders a video of a policy of every run with policies.npz: its median seed by the last ten evaluations.

    A run is rendered again when its policies are newer. The files are in a temporary folder; a run folder stays as it is.
    """

    def __init__(self, emit: Callable[[str], None] = lambda line: None):
        self._emit = emit
        self._folder = tempfile.TemporaryDirectory(prefix="earl_jax-videos-")
        self._films: dict[object, Film] = {}

    def films(self, line: Line) -> list[tuple[RunFolder, Film]]:
        """Return the film of each run of `line`, rendered now if its policies have changed since the last call."""
        first, films = 0, []
        for run in line.runs:
            last = first + len(run.config.seeds)
            films.append(
                (run, self._film(run, last_mean(line.curves.metrics[line.curves.deployed_metric][first:last])))
            )
            first = last
        return films

    def _film(self, run: RunFolder, scores: np.ndarray) -> Film:
        if not run.policies.exists():
            return Film(None, "", f"it has no {POLICIES}")
        status = run.policies.stat()
        version = (run.path, status.st_size, status.st_mtime_ns)
        if version not in self._films:
            self._films[version] = self._rendered(run, median_lane(scores))
        return self._films[version]

    def _rendered(self, run: RunFolder, lane: int) -> Film:
        """Return the film of a policy; an error in the files, the task or the drawing is its cause."""
        from earl_jax.rendering import render

        self._emit(f"rendering the policy of {run.path}")
        seeds = run.config.seeds
        median = f", the median of {len(seeds)}" if len(seeds) > 1 else ""
        file = Path(self._folder.name) / f"{len(self._films)}.mp4"
        try:
            caption = f"policy of seed {seeds[lane]}{median}, at step {policies_step(run.policies):,}"
            steps = round(SECONDS / run.config.build_env().step_seconds)
            render(run.path, file, "policy", seed=lane, steps=steps, size=SIZE, fps=FPS)
        except Exception as error:  # a folder is data: any error in it is reported and affects nothing else
            return Film(None, "", cause_of(error))
        return Film(file, caption)


def median_lane(scores: np.ndarray) -> int:
    """Return the lane with the median of `scores [N]`, the lower one of two."""
    return int(np.argsort(scores, kind="stable")[(len(scores) - 1) // 2])


def cause_of(error: Exception) -> str:
    """Return the first line of an error, for a sentence."""
    return (str(error).strip() or type(error).__name__).splitlines()[0].rstrip(".")
