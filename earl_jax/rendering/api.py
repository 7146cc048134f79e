"""`render`: a video, an animated gif or a contact sheet of a run folder or a task."""

import os
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from rich.progress import track

from earl_jax.envs import PAPER_TASKS
from earl_jax.errors import InputError
from earl_jax.options.jax_settings import package_types
from earl_jax.options.values import COUNT, Interval, require
from earl_jax.rendering.actors import actor_of
from earl_jax.rendering.output import SUPERSAMPLING, library, write_film, write_sheet
from earl_jax.rendering.scenes import Scene, checked_size
from earl_jax.rendering.shots import MOMENTS, frames, moments, portraits
from earl_jax.runs.contents import is_run
from earl_jax.runs.progress import stderr_console

ALL = "all"
"""The source that stands for the paper's six tasks."""
SIZES = {".mp4": (480, 640), ".gif": (240, 320), ".webp": (240, 320), ".png": (240, 320)}
"""Height and width of a frame, or of a moment on a sheet, by the suffix of the file."""
RATES = {".mp4": 25.0, ".gif": 12.5, ".webp": 12.5}
"""Largest number of frames per second by suffix, unless the caller sets another."""
FPS = Interval("[0.01, 1000]")


@package_types()
def render(
    source: str | Path,
    out: str | Path | None = None,
    acting: str | None = None,
    seed: int | None = None,
    steps: int | None = None,
    size: tuple[int, int] | None = None,
    fps: float | None = None,
    camera: str | None = None,
    progress: bool = False,
    policy: str | None = None,
    life: bool = False,
) -> Path:
    """Draw episodes of `source` in real time, each from s0 with a goal of its own, and return the path of the file.

    Args:
        source: a run folder, a task's name, or `all` for a moment of each of the paper's six tasks (.png).
        out: .mp4, .gif, .webp, or .png for a sheet of six moments; by default `video.mp4` in a run folder, else `TASK.mp4`, or
            `all.png`.
        acting: one of `ACTINGS`; by default the policy of a run, else the first that the task offers.
        seed: seed of starts and goals, by default 0; for a run, the seed whose policy also acts, by default its first.
        steps: total number of control steps; by default ten seconds, or at most one episode on a sheet.
        size: height and width of a frame, or of one moment of a sheet; the default depends on the suffix.
        fps: largest number of frames per second; the exact number follows from the task's control step.
        camera: one of the task's cameras.
        progress: whether to show a progress bar.
        policy: for a task, the method whose trained policy acts, one of `earl_jax.list_pretrained()[source]`.
        life: whether a film shows one life without resets. Its goals alternate between a task goal and an initial
            state; each lasts until it is reached or an episode's steps are over.

    Raises:
        ValueError: the source, suffix, acting, policy or camera is unknown, the source has no such acting or camera, a
            number is invalid, a video's height or width is odd, a library is missing, this machine cannot draw, `all`
            is combined with a policy, a camera or steps, or `life` with demonstrations or a sheet.
    """
    source = os.path.expanduser(str(source))
    path = output_path(source, out)
    size = checked_size(SIZES[path.suffix] if size is None else size)
    _check(path, size, life, steps, fps)
    large = SUPERSAMPLING * size[0], SUPERSAMPLING * size[1]
    if source == ALL:
        for name, value in (("policy", policy), ("camera", camera), ("number of steps", steps)):
            if value is not None:
                raise InputError(f"a {name} belongs to one task: name the task instead of {ALL}")
        actors = [actor_of(name, acting, seed) for name in PAPER_TASKS]
        return write_sheet(path, _tracked(portraits(actors, large), len(actors), progress), columns=3)
    actor = actor_of(source, acting, seed, policy)
    if life and actor.acting == "demos":
        raise InputError("demonstrations begin where they were recorded, so they are not a life: choose another acting")
    if path.suffix == ".png":
        return write_sheet(path, _tracked(moments(actor, large, camera, steps), MOMENTS, progress), columns=MOMENTS)
    with Scene(actor.env, size, camera) as scene:
        states, rate = frames(actor, steps, fps or RATES[path.suffix], life)
        return write_film(path, map(scene.image, _tracked(states, len(states), progress)), rate, size)


def output_path(source: str | Path, out: str | Path | None) -> Path:
    """Return the path of the file to write."""
    suffixes = [".png"] if str(source) == ALL else list(SIZES)
    path = Path(os.path.expanduser(out or (Path(source) / "video.mp4" if is_run(source) else f"{source}{suffixes[0]}")))
    if path.suffix not in suffixes:
        raise InputError(f"{path} has the suffix {path.suffix!r}; for {source} choose from {', '.join(suffixes)}")
    return path


def _check(path: Path, size: tuple[int, int], life: bool, steps: int | None, fps: float | None) -> None:
    """Raise a ValueError if `path` cannot have this `size` or be a `life`, a number is invalid or a library missing."""
    for name, value, interval in (("steps", steps, COUNT), ("fps", fps, FPS)):
        if value is not None:
            require(name, value, interval)
    if path.suffix == ".mp4" and any(length % 2 for length in size):
        raise InputError(f"a video needs an even height and width, not {size[0]} and {size[1]}")
    for name, is_given in (("life", life), ("fps", fps is not None)):
        if is_given and path.suffix == ".png":
            raise InputError(f"a sheet has no {name}: choose a film, such as .mp4, or leave it out")
    library("mediapy" if path.suffix == ".mp4" else "PIL")


def _tracked(items: Iterable[Any], total: int, show: bool) -> Iterable[Any]:
    """Return `items`, with a progress bar on stderr if `show` is set and stderr is a terminal."""
    console = stderr_console()
    return track(items, "drawing", total, console=console, transient=True, disable=not (show and console.is_terminal))
