"""Pictures of a page: maps of visited positions, and rendered videos as data URIs."""

import base64
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from earl_jax.errors import InputError
from earl_jax.metrics.visitation import measure
from earl_jax.report.html.policy_videos import PolicyVideos
from earl_jax.report.html.runs import Line, Run
from earl_jax.runs.contents import CHECKPOINTS, POLICIES
from earl_jax.runs.files import DamagedWarning
from earl_jax.runs.folder import RunFolder
from earl_jax.training import load_visits

FEW = 6
"""Fewer runs than this are named in a sentence; more are counted."""
MEGABYTE = 1_000_000
LARGEST = 20 * MEGABYTE
"""Most bytes of one video; larger ones are left out of the page."""
TOTAL = 100 * MEGABYTE
"""Most bytes of all videos of a page."""
KINDS = {".mp4": ("video/mp4", 4, b"ftyp"), ".gif": ("image/gif", 0, b"GIF8")}
"""Suffixes of videos: their type, and the bytes that identify it, with the position of these bytes."""


class VisitMap(NamedTuple):
    """Visits of one line's seeds, int [N, B, B], first axis x, over `map_bounds` [low, high] of [x, y] in `unit`."""

    line: Line
    visits: np.ndarray
    map_bounds: np.ndarray
    unit: str


def maps(lines: Sequence[Line]) -> tuple[list[dict[str, Any]], list[str]]:
    """Return the maps of one task's `lines`, ready to be drawn, and sentences about those that have none.

    Shares of visits are over all seeds; `ends` are the least and the largest share on any of the maps.
    """
    if lines[0].runs[0].config.build_env().map_bounds is None:
        return [], []
    line_maps, without, sentences = [], [], []
    for line in lines:
        with_map = [run for run in line.runs if any((run.path / name).exists() for name in (POLICIES, CHECKPOINTS))]
        without += [run.path for run in line.runs if run not in with_map]
        run_maps, problems = _run_maps(line, with_map)
        sentences += problems
        if run_maps:
            visits = np.concatenate([run_map.visits for run_map in run_maps])
            line_maps.append(run_maps[0]._replace(visits=visits))
    if without:
        named = line_maps and len(without) < FEW
        which = ", ".join(map(str, without)) if named else f"{len(without)} of these runs"
        sentences.insert(0, f"Without {POLICIES} or a checkpoint there is no map of visited positions: {which}.")
    return _drawn(line_maps), sentences


def _run_maps(line: Line, runs: Sequence[Run]) -> tuple[list[VisitMap], list[str]]:
    """Return the map of each run that can be read, and a sentence for each problem."""
    run_maps, sentences = [], []
    for run in runs:
        try:
            run_map, damages = _load_map(line, run)
            run_maps.append(run_map)
            sentences += damages
        except Exception as error:  # the files are data: any error in them is reported and affects nothing else
            text = (str(error).strip() or type(error).__name__).splitlines()[0].rstrip(".")
            sentences.append(f"No map of {line.group.label}: {text}.")
    return run_maps, sentences


def _load_map(line: Line, run: Run) -> tuple[VisitMap, list[str]]:
    """Return the newest map of a run, and a sentence for each newer checkpoint that is damaged."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", DamagedWarning)
        env, visits = load_visits(RunFolder(run.path, run.config))
    sentences = [f"{warning.message}." for warning in caught if issubclass(warning.category, DamagedWarning)]
    visit_map = VisitMap(line, np.asarray(visits), np.asarray(env.map_bounds, float), env.map_unit)
    return visit_map, sentences


def _drawn(line_maps: Sequence[VisitMap]) -> list[dict[str, Any]]:
    totals = [visit_map.visits.sum(axis=0) for visit_map in line_maps]
    shares = [total / max(total.sum(), 1) for total in totals]
    visited = np.concatenate([share[share > 0] for share in shares]) if shares else np.zeros(0)
    ends = [float(visited.min()), float(visited.max())] if len(visited) else [0.1, 1.0]
    drawn = []
    for visit_map, share in zip(line_maps, shares, strict=True):
        scores = [measure(visits) for visits in visit_map.visits]
        drawn.append(
            {
                "line": visit_map.line,
                "covered": float(np.mean([score["covered"] for score in scores])),
                "entropy": float(np.mean([score["entropy"] for score in scores])),
                "bounds": visit_map.map_bounds.tolist(),
                "unit": visit_map.unit,
                "shares": [[float(f"{value:.3g}") or None for value in column] for column in share.T.tolist()],
                "ends": ends,
            }
        )
    return drawn


class VideoEmbedder:
    """Turns the videos of run folders, and with `policies` those of their policies, into data URIs, as many as a page takes."""

    def __init__(self, policies: PolicyVideos | None = None):
        self.size, self.policies = 0, policies

    def videos(self, line: Line) -> tuple[list[dict[str, Any]], list[str]]:
        """Return the videos in the run folders of `line`, and a sentence for each that is left out."""
        videos, sentences = [], []
        for run in line.runs:
            files = sorted(path for path in run.path.iterdir() if path.suffix.lower() in KINDS)
            for file in files:
                try:
                    videos.append({"name": file.name, "line": line, **self._embedded(file)})
                except (OSError, ValueError) as error:
                    sentences.append(f"{file} is left out: {error}.")
        for run, film in self.policies.films(line) if self.policies else []:
            try:
                if film.file is None:
                    raise InputError(film.cause)
                videos.append({"name": film.caption, "line": line, **self._embedded(film.file)})
            except (OSError, ValueError) as error:
                sentences.append(f"No video of the policy of {run.path}: {error}.")
        return videos, sentences

    def _embedded(self, file: Path) -> dict[str, str]:
        """Return a video's `kind` and `uri`.

        Raises:
            ValueError: the file is a link, too large, of another kind, or would exceed the total size of a page.
        """
        if file.is_symlink() or not file.is_file():
            raise InputError("it is not a regular file")
        size = file.stat().st_size
        if size > LARGEST:
            megabytes, most = f"{size / MEGABYTE:.0f}", LARGEST // MEGABYTE
            raise InputError(f"it has {megabytes} MB, and a page takes videos of at most {most} MB")
        if self.size + size > TOTAL:
            raise InputError(f"the videos of a page have at most {TOTAL // MEGABYTE} MB together")
        kind, start, signature = KINDS[file.suffix.lower()]
        data = file.read_bytes()
        if data[start : start + len(signature)] != signature:
            raise InputError(f"it is not {kind}, although its name says so")
        self.size += size
        return {"kind": kind, "uri": f"data:{kind};base64,{base64.b64encode(data).decode()}"}
