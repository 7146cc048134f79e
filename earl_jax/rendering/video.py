"""Films: the states of an actor's episodes at an even pace, and .mp4, .gif and .webp files."""

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from earl_jax.envs import State
from earl_jax.rendering.actors import Actor, episodes
from earl_jax.rendering.output import atomic_file, library

RATES = {".mp4": 25.0, ".gif": 12.5, ".webp": 12.5}
"""Largest frames a second by suffix, unless the caller sets another."""
DEFAULT_SECONDS = 10.0
"""Length of a film, unless the caller sets the number of steps."""
CRF = 26
"""Compression of a video, as a constant rate factor; artefacts are invisible at 18."""
WEBP_QUALITY = 60
"""Quality of an animated .webp, of 100."""


def frames(actor: Actor, steps: int, stride: int) -> Iterator[State]:
    """Yield every `stride`-th state of episodes that have `steps` steps together."""
    for episode in episodes(actor):
        length = len(episode.states.reward)
        yield from (episode.at(number) for number in range(0, min(length, steps + 1), stride))
        steps -= length - 1
        if steps <= 0:
            return


def write_film(path: Path, images: Iterable[np.ndarray], fps: float, size: tuple[int, int]) -> Path:
    """Write `images` of height and width `size` at `fps` to a .mp4, .gif or .webp and return its path."""
    if path.suffix != ".mp4":
        return _write_animation(path, images, fps)
    mediapy = library("mediapy")
    mediapy.set_ffmpeg(library("imageio_ffmpeg").get_ffmpeg_exe())
    with atomic_file(path) as part, mediapy.VideoWriter(part, size, fps=fps, crf=CRF) as video:
        for image in images:
            video.add_image(image)
    return path


def _write_animation(path: Path, images: Iterable[np.ndarray], fps: float) -> Path:
    pillow = library("PIL.Image")
    pictures = map(pillow.fromarray, images)
    options: dict[str, Any] = {"quality": WEBP_QUALITY, "method": 6}
    if path.suffix == ".gif":
        pictures, options = (picture.quantize(128, dither=0) for picture in pictures), {"optimize": True}
    first, *rest = pictures
    with atomic_file(path) as part:
        first.save(part, save_all=True, append_images=rest, duration=round(1000 / fps), loop=0, **options)
    return path
