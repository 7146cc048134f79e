"""Commands that make demonstrations: demos, import-demos."""

from pathlib import Path

from earl_jax.cli.arguments import Engine, Positional
from earl_jax.errors import InputError


def demos(env: Positional[str], out: Path, seed: int = 0, engine: Engine = None) -> None:
    """Record demonstrations of a task with its scripted expert.

    Args:
        env: Task.
        out: Output file, .npz.
        seed: Random seed of the expert's noise. Seed 0 gives the file that ships with the package.
    """
    from earl_jax import envs
    from earl_jax.demos import scripted

    task = envs.with_engine(envs.make(env), engine)
    scripted.save(scripted.make(task, seed), out)
    print(out)


def import_demos(file: Positional[Path], backward: Path | None = None, out: Path | None = None) -> None:
    """Convert demonstrations of the original release into a file for training (--set demo_file=OUT).

    Args:
        file: Forward demonstrations: the original pickle, or an npz file of the same arrays. No code in it is executed.
        backward: Backward demonstrations in the same format. Methods with a return phase need them. By default none.
        out: New npz file. By default a file beside FILE.
    """
    from earl_jax.demos import importer, scripted

    target = out or file.with_name(f"{file.stem}_imported.npz")
    if target.exists():
        raise InputError(f"{target} exists; choose another file with --out")
    files = {"forward": file} if backward is None else {"forward": file, "backward": backward}
    imported = importer.import_demos(files)
    scripted.save(imported, target)
    print(f"{target}: " + ", ".join(f"{int(demos.ends.sum())} {direction}" for direction, demos in imported.items()))
