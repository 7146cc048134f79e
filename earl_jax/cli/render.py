"""The command that makes videos and pictures: render."""

from pathlib import Path
from typing import Annotated, Literal

import tyro

from earl_jax.cli.arguments import Positional, replacing


def render(
    source: Positional[str],
    out: Path | None = None,
    acting: Literal["policy", "expert", "demos", "random"] | None = None,
    seed: int = 0,
    steps: int | None = None,
    size: Annotated[tuple[int, int] | None, tyro.conf.arg(metavar="HEIGHT WIDTH")] = None,
    fps: float | None = None,
    camera: str | None = None,
    policy: str | None = None,
) -> None:
    """Render a trained policy, a scripted expert, the demonstrations or random actions, as a video or a picture.

    Args:
        source: Run folder, task, or all (one picture of the paper's six tasks).
        out: File to write: .mp4, .gif, .webp, or .png for a sheet of six moments. By default video.mp4 in a run folder, or
            TASK.mp4.
        acting: Source of the actions. By default the newest policy of a run, or the best that the task has.
        seed: Random seed of the starts and goals. For a run folder also the lane of the policy.
        steps: Total number of control steps. By default ten seconds, or one episode for a sheet.
        size: Height and width of a frame, or of one moment of a sheet. By default as the format has.
        fps: Largest number of frames per second. By default 25, or 12.5 for a .gif or .webp.
        camera: Camera of the task. By default the task's own. An unknown name lists the valid ones.
        policy: Method whose trained policy acts in a task, of those that ship. An unknown name lists them. By default none.
    """
    from earl_jax.rendering import api

    with replacing(api.output_path(source, out)):
        path = api.render(
            source,
            out,
            acting,
            seed=seed,
            steps=steps,
            size=size,
            fps=fps,
            camera=camera,
            policy=policy,
            progress=True,
        )
    print(path)
