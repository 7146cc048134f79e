"""Films: the states of an actor's episodes at an even pace, and .mp4 and .gif files."""

from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np

from earl_jax.envs import State
from earl_jax.rendering.actors import Actor, episodes
from earl_jax.rendering.output import atomic_file, library

RATES = {".mp4": 25.0, ".gif": 12.5}
"""Largest frames a second by suffix, unless the caller sets another."""
DEFAULT_SECONDS = 10.0
"""Length of a film, unless the caller sets the number of steps."""
CRF = 26
"""Compression of a video, as a constant rate factor; artefacts are invisible at 18."""


def frames(actor: Actor, steps: int, stride: int) -> Iterator[State]:
    """Yield every `stride`-th state of episodes that have `steps` steps together."""
    for episode in episodes(actor):
        length = len(episode.states.reward)
        yield from (episode.at(number) for number in range(0, min(length, steps + 1), stride))
        steps -= length - 1
        if steps <= 0:
            return


def write_film(path: Path, images: Iterable[np.ndarray], fps: float, size: tuple[int, int]) -> Path:
    """Write `images` of height and width `size` at `fps` to a .mp4 or .gif and return its path."""
    if path.suffix == ".gif":
        return _write_gif(path, images, fps)
    mediapy = library("mediapy")
    mediapy.set_ffmpeg(library("imageio_ffmpeg").get_ffmpeg_exe())
    with atomic_file(path) as part, mediapy.VideoWriter(part, size, fps=fps, crf=CRF) as video:
        for image in images:
            video.add_image(image)
    return path


def _write_gif(path: Path, images: Iterable[np.ndarray], fps: float) -> Path:
    first, *rest = [library("PIL.Image").fromarray(image).quantize(128, dither=0) for image in images]
    with atomic_file(path) as part:
        first.save(part, save_all=True, append_images=rest, duration=round(1000 / fps), loop=0, optimize=True)
    return path
