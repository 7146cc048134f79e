"""Contact sheets: captioned moments of an episode, or of several tasks, in one .png."""

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from earl_jax.rendering.actors import Actor, Episode, episodes
from earl_jax.rendering.output import atomic_file, library
from earl_jax.rendering.scenes import Scene

MOMENTS = 6
"""Moments on a sheet of one task."""
RANDOM_STEP = 40
"""The step that is shown of an episode of random actions."""
PORTRAIT_SHARE = 0.75
"""Share of an episode after which a sheet of several tasks shows it."""
SUPERSAMPLING = 2
"""Images are drawn at this multiple of their size and reduced, for smooth edges."""
CAPTION_COLOUR = (60, 64, 70)
GAP = 6
"""Pixels between two pictures."""

Shot = tuple[np.ndarray, str]
"""An image, `SUPERSAMPLING` times its size on the sheet, and its caption."""


class _Moment(NamedTuple):
    """One step of an episode, and the text before its caption."""

    episode: Episode
    step: int
    prefix: str = ""


def moments(actor: Actor, scene: Scene, steps: int | None) -> Iterator[Shot]:
    """Yield six moments with their captions.

    They show one episode up to its goal or `steps`; for random actions they show step 40, or `steps`, of six episodes.
    """
    seconds = actor.env.step_seconds
    for episode, step, prefix in _moments(actor, steps):
        step = min(step, len(episode.states.reward) - 1)
        reached = ", goal reached" * (episode.reached and step == episode.last)
        yield scene.image(episode.at(step)), f"{prefix}{step * seconds:.1f} s{reached}"


def _moments(actor: Actor, steps: int | None) -> list[_Moment]:
    upcoming = episodes(actor)
    if actor.acting == "random":
        step = steps or RANDOM_STEP
        return [_Moment(next(upcoming), step, f"start {number}, ") for number in range(1, MOMENTS + 1)]
    episode = next(upcoming)
    last = min(episode.last, steps or episode.last)
    return [_Moment(episode, round(step)) for step in np.linspace(0, last, MOMENTS)]


def portraits(actors: Iterable[Actor], size: tuple[int, int]) -> Iterator[Shot]:
    """Yield one moment of each of `actors`, captioned with the task's name; `size` is height and width on the sheet."""
    for actor in actors:
        episode = next(episodes(actor))
        step = RANDOM_STEP if actor.acting == "random" else round(PORTRAIT_SHARE * episode.last)
        with Scene(actor.env, supersampled(size)) as scene:
            yield scene.image(episode.at(step)), actor.env.name


def supersampled(size: tuple[int, int]) -> tuple[int, int]:
    """Return the height and width at which to draw an image that has height and width `size` on a sheet."""
    height, width = size
    return SUPERSAMPLING * height, SUPERSAMPLING * width


def write_sheet(path: Path, shots: Iterable[Shot], columns: int) -> Path:
    """Write images with their captions below, in rows of `columns`, to a .png and return its path."""
    image, draw, fonts = (library(f"PIL.{name}") for name in ("Image", "ImageDraw", "ImageFont"))
    pictures = [(image.fromarray(pixels).reduce(SUPERSAMPLING), caption) for pixels, caption in shots]
    width, height = pictures[0][0].size
    font = fonts.load_default(max(10, height / 14))
    column_width = width + GAP
    row_height = height + round(1.7 * font.size)
    rows = -(-len(pictures) // columns)
    sheet = image.new("RGB", (columns * column_width - GAP, rows * row_height), "white")
    pen = draw.Draw(sheet)
    for number, (picture, caption) in enumerate(pictures):
        row, column = divmod(number, columns)
        x, y = column * column_width, row * row_height
        sheet.paste(picture, (x, y))
        centre = (x + width / 2, y + (height + row_height) / 2)
        pen.text(centre, caption, CAPTION_COLOUR, font, anchor="mm")
    with atomic_file(path) as part:
        sheet.quantize(256, kmeans=3).save(part, optimize=True)
    return path
