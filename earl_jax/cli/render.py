"""The command that makes pictures: render."""

from pathlib import Path
from typing import Literal

from earl_jax.cli.arguments import Positional


def render(
    source: Positional[str],
    out: Path | None = None,
    acting: Literal["policy", "expert", "demos", "random"] | None = None,
    seed: int = 0,
    steps: int | None = None,
    size: tuple[int, int] | None = None,
    fps: float | None = None,
    camera: str | None = None,
) -> None:
    """Show what a learnt policy, a scripted expert, the demonstrations or chance do, as a video or a picture.

    Args:
        source: a run folder, a task, or all (one picture of the paper's six tasks).
        out: .mp4, .gif, or .png for a sheet of six moments; video.mp4 in a run folder or TASK.mp4 by default.
        acting: who acts; by default the newest policy of a run, else the best that the task has.
        seed: of starts and goals; in a run folder also which lane's policy acts.
        steps: control steps in all; ten seconds of them by default, on a sheet one episode.
        size: height and width of a frame, or of one moment of a sheet.
        fps: frames a second at most; 25 by default, 12.5 in a .gif.
        camera: one of the task's cameras; an unknown name lists them.
    """
    from earl_jax.rendering.video import render as draw

    print(draw(source, out, acting, seed, steps, size, fps, camera, progress=True))
