"""Commands that make demonstrations: demos, import-demos."""

from pathlib import Path

from earl_jax.cli.arguments import Physics, Positional


def demos(env: Positional[str], out: Path, seed: int = 0, physics: Physics = None) -> None:
    """Make a task's demonstrations anew with its scripted expert.

    Args:
        env: the task.
        out: an npz file.
        seed: of the expert's noise; 0 gives the file that ships.
    """
    from earl_jax import envs
    from earl_jax.demos import scripted as making

    making.save(making.make(envs.with_physics(envs.make(env), physics), seed), out)
    print(out)


def import_demos(file: Positional[Path], backward: Path | None = None, out: Path | None = None) -> None:
    """Turn demonstrations of the original release into a file to train with: --set demo_file=OUT.

    Args:
        file: forward demonstrations, the original's pickle or an npz of the same arrays; nothing in it is executed.
        backward: backward demonstrations likewise; methods with a return phase need them.
        out: a new npz file; beside FILE by default.
    """
    from earl_jax.demos import importer as recordings
    from earl_jax.demos import scripted as making

    target = out or file.with_name(f"{file.stem}_imported.npz")
    if target.exists():
        raise ValueError(f"{target} exists; choose another file with --out")
    files = {"forward": file} if backward is None else {"forward": file, "backward": backward}
    found = recordings.import_demos(files)
    making.save(found, target)
    print(f"{target}: " + ", ".join(f"{int(part.ends.sum())} {name}" for name, part in found.items()))
