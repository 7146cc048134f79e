"""Pictures of a page: maps of visited places out of checkpoints, and rendered videos as data URIs."""

import base64
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from earl_jax.metrics.visitation import measure
from earl_jax.paper.figure4 import UNITS
from earl_jax.report.html.runs import Line, Run
from earl_jax.runs.files import DamagedWarning
from earl_jax.runs.folder import RunFolder
from earl_jax.training import load_lanes

FEW = 6
"""Runs that a sentence names; more are counted."""
MEGABYTE = 1_000_000
LARGEST = 20 * MEGABYTE
"""Bytes of one video; larger ones stay out of the page."""
TOGETHER = 100 * MEGABYTE
"""Bytes of all videos of a page."""
KINDS = {".mp4": ("video/mp4", 4, b"ftyp"), ".gif": ("image/gif", 0, b"GIF8")}
"""Suffixes of videos: their type, and the bytes by which they are known, with where these lie."""


class Visited(NamedTuple):
    """Visits of one line's seeds, int [N, B, B], x before y, over `map_bounds` [[x, y] low, [x, y] high]."""

    line: Line
    visits: np.ndarray
    map_bounds: np.ndarray


def maps(lines: Sequence[Line]) -> tuple[list[dict[str, Any]], list[str]]:
    """Return the maps of one task's `lines`, ready to be drawn, and a sentence for those that have none.

    Shares of visits are over all seeds; `low` and `high` are the least and largest share on any of the maps.
    """
    if lines[0].runs[0].config.build_env().map_bounds is None:
        return [], []
    found, without, sentences = [], [], []
    for line in lines:
        kept = []
        for run in line.runs:
            if not (run.path / "checkpoints").is_dir():
                without.append(run.path)
                continue
            try:
                one, told = _visited(line, run)
                kept.append(one)
                sentences += told
            except (
                Exception
            ) as error:  # a checkpoint is data: whatever is wrong with it is told, and costs nothing else
                text = (str(error).strip() or type(error).__name__).splitlines()[0].rstrip(".")
                sentences.append(f"No map of {line.cell.label}: {text}.")
        if kept:
            found.append(kept[0]._replace(visits=np.concatenate([one.visits for one in kept])))
    if without:
        which = ", ".join(map(str, without)) if found and len(without) < FEW else f"{len(without)} of these runs"
        sentences.insert(0, f"Without a checkpoint there is no map of visited places: {which}.")
    return _drawn(found), sentences


def _visited(line: Line, run: Run) -> tuple[Visited, list[str]]:
    """Return where one run has been by its newest whole checkpoint, and a sentence for each newer one that is damaged."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", DamagedWarning)
        env, _, lanes = load_lanes(RunFolder(run.path, run.config))
    told = [f"{one.message}." for one in caught if issubclass(one.category, DamagedWarning)]
    return Visited(line, np.asarray(lanes.visits), np.asarray(env.map_bounds, float)), told


def _drawn(found: Sequence[Visited]) -> list[dict[str, Any]]:
    totals = [one.visits.sum(axis=0) for one in found]
    shares = [total / max(total.sum(), 1) for total in totals]
    seen = np.concatenate([share[share > 0] for share in shares]) if shares else np.zeros(0)
    ends = [float(seen.min()), float(seen.max())] if len(seen) else [0.1, 1.0]
    drawn = []
    for one, share in zip(found, shares, strict=True):
        scores = [measure(part) for part in one.visits]
        drawn.append(
            {
                "line": one.line,
                "covered": float(np.mean([score["covered"] for score in scores])),
                "entropy": float(np.mean([score["entropy"] for score in scores])),
                "area": one.map_bounds.tolist(),
                "unit": UNITS.get(one.line.cell.env, "m"),
                "shares": [[float(f"{value:.3g}") or None for value in column] for column in share.T.tolist()],
                "ends": ends,
            }
        )
    return drawn


class Album:
    """Videos of run folders as data URIs, as many as fit a page."""

    def __init__(self):
        self.size = 0

    def videos(self, line: Line) -> tuple[list[dict[str, Any]], list[str]]:
        """Return the videos that lie in the run folders of `line`, and a sentence for each that stays out."""
        found, sentences = [], []
        for run in line.runs:
            files = sorted(path for path in run.path.iterdir() if path.suffix.lower() in KINDS)
            for file in files:
                try:
                    found.append({"name": file.name, "line": line, **self._embedded(file)})
                except (OSError, ValueError) as error:
                    sentences.append(f"{file} is left out: {error}.")
        return found, sentences

    def _embedded(self, file: Path) -> dict[str, str]:
        """Return a video's `kind` and `uri`; a link, a file of another kind and one too many are ValueErrors."""
        if file.is_symlink() or not file.is_file():
            raise ValueError("it is no plain file")
        size = file.stat().st_size
        if size > LARGEST:
            raise ValueError(
                f"it has {size / MEGABYTE:.0f} MB, and a page takes videos of at most {LARGEST // MEGABYTE} MB"
            )
        if self.size + size > TOGETHER:
            raise ValueError(f"the videos of a page have at most {TOGETHER // MEGABYTE} MB together")
        kind, start, mark = KINDS[file.suffix.lower()]
        data = file.read_bytes()
        if data[start : start + len(mark)] != mark:
            raise ValueError(f"it is no {kind}, whatever its name says")
        self.size += size
        return {"kind": kind, "uri": f"data:{kind};base64,{base64.b64encode(data).decode()}"}
