"""Commands that act in a task or keep episodes: render, demos, import-demos, export."""

from pathlib import Path
from typing import Annotated, Literal

import tyro

from earl_jax.cli.arguments import Positional, replacing
from earl_jax.errors import InputError


def render(
    source: Positional[str],
    out: Path | None = None,
    acting: Literal["policy", "expert", "demos", "random"] | None = None,
    seed: int | None = None,
    steps: int | None = None,
    size: Annotated[tuple[int, int] | None, tyro.conf.arg(metavar="HEIGHT WIDTH")] = None,
    fps: float | None = None,
    camera: str | None = None,
    policy: str | None = None,
    life: bool = False,
) -> None:
    """Render a trained policy, a scripted expert, the demonstrations or random actions, as a video or a picture.

    Args:
        source: Run folder, task, or all (one picture of the paper's six tasks).
        out: File to write: .mp4, .gif, .webp, or .png for a sheet of six moments. By default video.mp4 in a run folder, or
            TASK.mp4.
        acting: Source of the actions. By default the newest policy of a run, or the first of these that a task offers.
        seed: Random seed of the starts and goals; for a run, also the seed whose policy acts. By default 0, or the run's
            first.
        steps: Total number of control steps. By default ten seconds, or one episode for a sheet.
        size: Height and width of a frame, or of one moment of a sheet. The default depends on the format.
        fps: Largest number of frames per second. By default 25, or 12.5 for a .gif or .webp.
        camera: Camera of the task. By default the task's own. An unknown name lists the valid ones.
        policy: Method whose shipped trained policy acts in a task. An unknown name lists the methods. By default none.
        life: Show one life without resets. Its goals alternate between a task goal and an initial state.
    """
    from earl_jax.rendering import api

    with replacing(api.output_path(source, out)):
        path = api.render(source, out, acting, seed, steps, size, fps, camera, policy=policy, life=life, progress=True)
    print(path)


def demos(env: Positional[str], out: Path, seed: int = 0, engine: str | None = None) -> None:
    """Record demonstrations of a task with its scripted expert.

    Args:
        env: Task.
        out: Output file, .npz.
        seed: Random seed of the starts and of the expert's noise. Seed 0 reproduces the shipped file, if there is one.
    """
    from earl_jax import envs
    from earl_jax.envs.demos import scripted

    task = envs.with_engine(envs.make(env), engine)
    with replacing(out):
        scripted.save(scripted.make(task, seed), out)
    print(out)


def import_demos(file: Positional[Path], backward: Path | None = None, out: Path | None = None) -> None:
    """Convert demonstrations of the original release into a file for training (--set demo_file=OUT).

    Args:
        file: Forward demonstrations: the original pickle, or an npz file of the same arrays. Its code is not executed.
        backward: Backward demonstrations in the same format, for return phases. By default none.
        out: New npz file. By default a file beside FILE.
    """
    from earl_jax.envs.demos import importer, scripted

    target = out or file.with_name(f"{file.stem}_imported.npz")
    if target.exists():
        raise InputError(f"{target} already exists; choose another file with --out")
    files = {"forward": file} if backward is None else {"forward": file, "backward": backward}
    imported = {direction: importer.read(path) for direction, path in files.items()}
    scripted.save(imported, target)
    print(f"{target}: " + ", ".join(f"{int(demos.ends.sum())} {direction}" for direction, demos in imported.items()))


def export(
    source: Positional[str],
    dataset: str | None = None,
    seed: int | None = None,
    direction: Literal["forward", "backward"] | None = None,
) -> None:
    """Write a run's replay, or the demonstrations of a task, as a Minari dataset.

    Args:
        source: Run folder with a checkpoint, or task.
        dataset: Name of the new dataset. By default earl_jax/TASK/METHOD-seed-SEED-v0, or earl_jax/TASK/DIRECTION-v0.
        seed: Seed of the run whose life is exported. By default the run's first.
        direction: Direction of the demonstrations of a task. By default forward.
    """
    from earl_jax.adapters import minari
    from earl_jax.runs.contents import is_run
    from earl_jax.runs.folder import RunFolder
    from earl_jax.training import load_transitions

    if is_run(source):
        if direction is not None:
            raise InputError(f"{source} is a run, whose whole life is exported: leave out --direction")
        config = RunFolder.open(source).config
        seed = config.seeds[0] if seed is None else seed
        env, transitions, terminal = load_transitions(source, seed)
        name = dataset or f"earl_jax/{config.env}/{config.algo}-seed-{seed}-v0"
        written = minari.write(name, env, transitions, terminal, config.algo, f"The life of seed {seed} in {source}")
    else:
        if seed is not None:
            raise InputError(f"{source} is not a run, and demonstrations have no seed: leave out --seed")
        written = minari.demonstrations(source, direction or "forward", dataset)
    spec = written.spec
    print(f"{spec.dataset_id}: {spec.total_episodes} episodes, {spec.total_steps} steps, in {spec.data_path}")
