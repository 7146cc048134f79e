"""Pictures of a page: maps of visited positions, and videos as data URIs."""

import base64
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from earl_jax.errors import InputError
from earl_jax.metrics.visitation import measure
from earl_jax.report.html.lines import Line
from earl_jax.report.html.policy_videos import PolicyVideos, cause_of
from earl_jax.runs.contents import POLICIES
from earl_jax.runs.files import DamagedWarning
from earl_jax.training import load_visits

MEGABYTE = 1_000_000
LARGEST = 20 * MEGABYTE
"""Most bytes of one video; larger ones are left out of the page."""
TOTAL = 100 * MEGABYTE
"""Most bytes of all videos of a page."""
KINDS = {".mp4": "video/mp4", ".gif": "image/gif"}
"""The types of videos by their suffix."""


def maps(lines: Sequence[Line]) -> tuple[list[dict[str, Any]], list[str]]:
    """Return the maps of one task's `lines`, ready to be drawn, and sentences about those that have none.

    Shares of visits are over all seeds; `ends` are the least and the largest share on any of the maps.
    """
    if lines[0].runs[0].config.build_env().map_bounds is None:
        return [], []
    drawn, sentences = [], []
    for line in lines:
        visits, problems = _visits(line)
        sentences += problems
        if visits is not None:
            drawn.append(_drawn(line, visits))
    shares = [share for visit_map in drawn for column in visit_map["shares"] for share in column if share]
    ends = [min(shares), max(shares)] if shares else [0.1, 1.0]
    return [{**visit_map, "ends": ends} for visit_map in drawn], sentences


def _visits(line: Line) -> tuple[np.ndarray | None, list[str]]:
    """Return the visits of all seeds of a line, [N, B, B] or None, and a sentence for each problem with a run's files."""
    runs = [run for run in line.runs if run.policies.exists() or run.checkpoints.exists()]
    parts, sentences = [], []
    if without := len(line.runs) - len(runs):
        sentences.append(f"No map of {without} runs of {line.group.label}: they have no {POLICIES} and no checkpoint.")
    for run in runs:
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always", DamagedWarning)
            try:
                parts.append(np.asarray(load_visits(run)[1]))
            except Exception as error:  # the files are data: any error in them is reported and affects nothing else
                sentences.append(f"No map of {line.group.label}: {cause_of(error)}.")
        sentences += [f"{warning.message}." for warning in caught if issubclass(warning.category, DamagedWarning)]
    return (np.concatenate(parts) if parts else None), sentences


def _drawn(line: Line, visits: np.ndarray) -> dict[str, Any]:
    """Return the map of `visits [N, B, B]`, whose first axis is x."""
    env, total, scores = line.runs[0].config.build_env(), visits.sum(axis=0), [measure(part) for part in visits]
    return {
        "line": line,
        "covered": float(np.mean([score["covered"] for score in scores])),
        "entropy": float(np.mean([score["entropy"] for score in scores])),
        "bounds": np.asarray(env.map_bounds, float).tolist(),
        "unit": env.map_unit,
        "shares": [[float(f"{v:.3g}") or None for v in row] for row in (total.T / max(total.sum(), 1)).tolist()],
    }


class VideoEmbedder:
    """Turns the videos of run folders, and with `policies` those of their policies, into data URIs, as many as a page takes."""

    def __init__(self, policies: PolicyVideos | None = None):
        self.size, self.policies = 0, policies

    def videos(self, line: Line) -> tuple[list[dict[str, Any]], list[str]]:
        """Return the videos in the run folders of `line`, and a sentence for each that is left out."""
        found: list[tuple[Path | None, str, str, str]] = [
            (file, file.name, f"{file} is left out", "")
            for run in line.runs
            for file in sorted(path for path in run.path.iterdir() if path.suffix.lower() in KINDS)
        ]
        for run, film in self.policies.films(line) if self.policies else []:
            found.append((film.file, film.caption, f"No video of the policy of {run.path}", film.cause))
        videos, sentences = [], []
        for file, name, absent, cause in found:
            try:
                videos.append({"name": name, "line": line, **self._embedded(file, cause)})
            except (OSError, ValueError) as error:
                sentences.append(f"{absent}: {error}.")
        return videos, sentences

    def _embedded(self, file: Path | None, cause: str) -> dict[str, str]:
        """Return a video's `kind` and `uri`.

        Raises:
            ValueError: there is no file, for this `cause`, it is a link, too large, or would exceed the size of a page.
        """
        if file is None or file.is_symlink() or not file.is_file():
            raise InputError(cause or "it is not a regular file")
        size = file.stat().st_size
        if size > LARGEST:
            megabytes, most = f"{size / MEGABYTE:.0f}", LARGEST // MEGABYTE
            raise InputError(f"it has {megabytes} MB, and a page takes videos of at most {most} MB")
        if self.size + size > TOTAL:
            raise InputError(f"the videos of a page have at most {TOTAL // MEGABYTE} MB together")
        self.size += size
        kind = KINDS[file.suffix.lower()]
        return {"kind": kind, "uri": f"data:{kind};base64,{base64.b64encode(file.read_bytes()).decode()}"}
