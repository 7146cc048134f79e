"""Pictures of a page: maps of visited positions, and videos as data URIs."""

import base64
import tempfile
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from earl_jax.envs import Map
from earl_jax.errors import InputError
from earl_jax.metrics.visitation import measure
from earl_jax.report.html.curves import Line
from earl_jax.report.scores import seed_scores
from earl_jax.runs.contents import POLICIES
from earl_jax.runs.folder import RunFolder
from earl_jax.runs.policies import policies_step
from earl_jax.training import load_visits

MEGABYTE = 1_000_000
LARGEST = 20 * MEGABYTE
"""Most bytes of one video; larger ones are left out of the page."""
TOTAL = 100 * MEGABYTE
"""Most bytes of all videos of a page."""
KINDS = {".mp4": "video/mp4", ".gif": "image/gif"}
"""The types of videos by their suffix."""
SECONDS = 6.0
"""Length of the video of a policy: one episode or a few."""
SIZE, FPS = (240, 320), 12.5


def maps(lines: Sequence[Line]) -> tuple[list[dict[str, Any]], list[str]]:
    """Return the maps of one task's `lines`, whose `plot` is drawn, and sentences about runs that have none.

    Shares of visits are over all seeds; `ends` are the least and the largest share on any of the maps.
    """
    try:
        task_map = lines[0].curves.runs[0].config.build_env().map
    except InputError as error:
        return [], [f"No maps of {lines[0].curves.env}: {_cause(error)}."]
    if task_map is None:
        return [], []
    drawn, sentences = [], []
    for line in lines:
        visits = []
        for run in line.curves.runs:
            try:
                whole = RunFolder.open(run.path)
                counts = np.asarray(load_visits(whole)[1])[np.isin(whole.config.seeds, run.config.seeds)]
                if visits and counts.shape[1:] != visits[0].shape[1:]:
                    raise InputError(f"{run.path} has maps of {len(counts[0])} bins, another of {len(visits[0][0])}")
                visits.append(counts)
            except Exception as error:  # the files are data: any error in them is reported and affects nothing else
                sentences.append(f"No map of {line.curves.label}: {_cause(error)}.")
        if visits:
            drawn.append(_map(line, task_map, np.concatenate(visits)))
    shares = [share for visit_map in drawn for row in visit_map["plot"]["shares"] for share in row if share]
    for visit_map in drawn:
        visit_map["plot"]["ends"] = [min(shares), max(shares)] if shares else [0.1, 1.0]
    return drawn, sentences


def _map(line: Line, task_map: Map, visits: np.ndarray) -> dict[str, Any]:
    """Return the map of `visits [N, B, B]`, whose first axis is x."""
    total, measures = visits.sum(axis=0), [measure(part) for part in visits]
    return {
        "line": line,
        **{name: float(np.mean([of_seed[name] for of_seed in measures])) for name in ("covered", "entropy")},
        "plot": {
            "bounds": np.asarray(task_map.bounds, float).tolist(),
            "unit": task_map.unit,
            "shares": [[float(f"{v:.3g}") or None for v in row] for row in (total.T / max(total.sum(), 1)).tolist()],
        },
    }


class Film(NamedTuple):
    """The file of a video and what it shows, or without a file the `problem`."""

    file: Path | None
    caption: str = ""
    problem: str = "it is not a regular file"


class PolicyVideos:
    """Renders a video of a policy of every run with policies.npz: its median seed by score.

    A run is rendered again when its policies are newer. The files are in a temporary folder; a run folder stays as it is.
    """

    def __init__(self, emit: Callable[[str], None] = lambda line: None):
        self._emit = emit
        self._folder = tempfile.TemporaryDirectory(prefix="earl_jax-videos-")
        self._films: dict[object, Film] = {}

    def film(self, run: RunFolder, scores: np.ndarray) -> Film:
        """Return the film of `run`, whose seeds have `scores [N]`, rendered now if its policies are new."""
        if not run.policies.exists():
            return Film(None, problem=f"it has no {POLICIES}")
        status = run.policies.stat()
        version = (run.path, run.config.seeds, status.st_size, status.st_mtime_ns)
        if version not in self._films:
            self._emit(f"rendering the policy of {run.path}")
            lower_median = int(np.argsort(scores, kind="stable")[(len(scores) - 1) // 2])
            self._films[version] = self._rendered(run, lower_median)
        return self._films[version]

    def _rendered(self, run: RunFolder, lane: int) -> Film:
        """Return the film of a policy; an error in the files, the task or the drawing is its problem."""
        from earl_jax.rendering import render
        from earl_jax.rendering.scenes import view_of

        seeds = run.config.seeds
        median = f", the median of {len(seeds)}" if len(seeds) > 1 else ""
        file = Path(self._folder.name) / f"{len(self._films)}.mp4"
        try:
            caption = f"policy of seed {seeds[lane]}{median}, at step {policies_step(run.policies):,}"
            steps = round(SECONDS / view_of(run.config.build_env()).dt)
            render(run.path, file, "policy", seed=seeds[lane], steps=steps, size=SIZE, fps=FPS)
        except Exception as error:  # a folder is data: any error in it is reported and affects nothing else
            return Film(None, problem=_cause(error))
        return Film(file, caption)


class Video(NamedTuple):
    """A video of a line as a data URI, or a sentence with the `problem` for which it is not on the page."""

    line: Line
    name: str
    kind: str = ""
    uri: str = ""
    problem: str = ""


def videos(lines: Sequence[Line], policies: PolicyVideos | None = None) -> list[Video]:
    """Return the videos in the run folders of a page's `lines`, and with `policies` those of their policies.

    Links, files that are too large, and more than a page takes have a `problem`.
    """
    embedded, room = [], TOTAL
    for line in lines:
        for film, absent in _films(line, policies):
            try:
                kind, content = _content(film, room)
                room -= len(content)
                uri = f"data:{kind};base64,{base64.b64encode(content).decode()}"
                embedded.append(Video(line, film.caption, kind, uri))
            except (OSError, ValueError) as error:
                embedded.append(Video(line, film.caption, problem=f"{absent}: {error}."))
    return embedded


def _films(line: Line, policies: PolicyVideos | None) -> Iterator[tuple[Film, str]]:
    """Yield the videos of a line, each with the start of the sentence about its problem."""
    scores = dict(zip(line.seeds, seed_scores(line.curves), strict=True))
    for run in line.curves.runs:
        for file in sorted(run.path.iterdir()):
            if file.suffix.lower() in KINDS:
                yield Film(file, file.name), f"{file} is left out"
        if policies:
            own = np.array([scores[seed] for seed in run.config.seeds])
            yield policies.film(run, own), f"No video of the policy of {run.path}"


def _content(film: Film, room: int) -> tuple[str, bytes]:
    """Return type and content of a video; an InputError if it is not a file, or larger than allowed or than `room`."""
    if film.file is None or film.file.is_symlink() or not film.file.is_file():
        raise InputError(film.problem)
    size = film.file.stat().st_size
    if size > LARGEST:
        most = LARGEST // MEGABYTE
        raise InputError(f"it has {size / MEGABYTE:.0f} MB, and a page takes videos of at most {most} MB")
    if size > room:
        raise InputError(f"the videos of a page have at most {TOTAL // MEGABYTE} MB together")
    return KINDS[film.file.suffix.lower()], film.file.read_bytes()


def _cause(error: Exception) -> str:
    """Return the first line of an error, for a sentence."""
    return (str(error).strip() or type(error).__name__).splitlines()[0].rstrip(".")
