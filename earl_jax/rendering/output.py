"""Files of pictures and videos: films as .mp4, .gif and .webp, and contact sheets as .png."""

import functools
import io
import itertools
import tempfile
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from earl_jax.errors import optional
from earl_jax.runs.files import written

CRF = 26
"""Compression of a video, as a constant rate factor; artefacts are invisible at 18."""
WEBP_QUALITY = 60
"""Quality of an animated .webp, of 100."""
SUPERSAMPLING = 2
"""The images of a sheet are drawn at this multiple of their size and reduced, for smooth edges."""
CAPTION_COLOUR = (60, 64, 70)
GAP = 6
"""Pixels between two pictures of a sheet."""

Shot = tuple[np.ndarray, str]
"""An image, `SUPERSAMPLING` times its size on the sheet, and its caption."""


library = functools.partial(optional, need="pictures need", extra="render")
"""`library(module)` returns a module that pictures need."""


def write_film(path: Path, images: Iterable[np.ndarray], fps: float, size: tuple[int, int]) -> Path:
    """Write `images` of height and width `size` at `fps` to a .mp4, .gif or .webp and return its path."""
    if path.suffix != ".mp4":
        return _write_animation(path, images, fps)
    mediapy = library("mediapy")
    mediapy.set_ffmpeg(library("imageio_ffmpeg").get_ffmpeg_exe())
    with tempfile.TemporaryDirectory() as folder:
        part = Path(folder, path.name)
        with mediapy.VideoWriter(part, size, fps=fps, crf=CRF) as video:
            for image in images:
                video.add_image(image)
        return written(path, part.read_bytes())


def _write_animation(path: Path, images: Iterable[np.ndarray], fps: float) -> Path:
    pictures = map(library("PIL.Image").fromarray, images)
    options: dict[str, Any] = {"format": "WEBP", "quality": WEBP_QUALITY, "method": 6}
    unit = 1  # milliseconds, in which a format counts
    if path.suffix == ".gif":
        pictures = (picture.quantize(128, dither=0) for picture in pictures)
        options, unit = {"format": "GIF", "optimize": True}, 10
    film = io.BytesIO()
    first, *rest = pictures
    times = [round(1000 / fps / unit * number) for number in range(len(rest) + 2)]
    durations = [unit * max(1, until - since) for since, until in itertools.pairwise(times)]
    first.save(film, save_all=True, append_images=rest, duration=durations, loop=0, **options)
    return written(path, film.getvalue())


def write_sheet(path: Path, shots: Iterable[Shot], columns: int) -> Path:
    """Write images with their captions below, in rows of `columns`, to a .png and return its path."""
    image, draw, fonts = (library(f"PIL.{name}") for name in ("Image", "ImageDraw", "ImageFont"))
    pictures = [(image.fromarray(pixels).reduce(SUPERSAMPLING), caption) for pixels, caption in shots]
    width, height = pictures[0][0].size
    font = fonts.load_default(max(10, height / 14))
    column_width, row_height = width + GAP, height + round(1.7 * font.size)
    rows = -(-len(pictures) // columns)
    sheet = image.new("RGB", (columns * column_width - GAP, rows * row_height), "white")
    pen = draw.Draw(sheet)
    for number, (picture, caption) in enumerate(pictures):
        row, column = divmod(number, columns)
        x, y = column * column_width, row * row_height
        sheet.paste(picture, (x, y))
        pen.text((x + width / 2, y + (height + row_height) / 2), caption, CAPTION_COLOUR, font, anchor="mm")
    content = io.BytesIO()
    sheet.quantize(256, kmeans=3).save(content, "PNG", optimize=True)
    return written(path, content.getvalue())
