"""Write the demonstrations for runs with the authors' recordings: `python -m benchmarks.paper.recorded_demos TASK FORWARD.npz`.

Writes recorded/TASK.npz for `--set demo_file=recorded/TASK.npz`. A direction
without a recording has our own demonstrations, since methods with a return phase need both: only the forward recordings of
door and peg were at hand.
"""

import argparse
from pathlib import Path

from earl_jax import assets
from earl_jax.assets import Demos
from earl_jax.demos.importer import read
from earl_jax.demos.scripted import save
from earl_jax.envs import PAPER_TASKS
from earl_jax.errors import InputError

FOLDER = Path("recorded")


def with_recordings(task: str, files: dict[str, Path]) -> dict[str, Demos]:
    """Return the demonstrations of `task` in both directions, recorded ones from `files` by direction, ours otherwise.

    Raises:
        ValueError: a file is not a recording, or its states have another size than those of the task.
    """
    ours = {direction: assets.demos(task, direction) for direction in assets.demo_directions(task)}
    recorded = {direction: read(path).demos() for direction, path in files.items()}
    for direction, demos in recorded.items():
        sizes = demos.states.shape[1], ours[direction].states.shape[1]
        if sizes[0] != sizes[1]:
            raise InputError(f"a state in {files[direction]} has {sizes[0]} numbers, and one of {task} {sizes[1]}")
    return {**ours, **recorded}


def main() -> None:
    """Write the file of one task."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("task", choices=[task for task in PAPER_TASKS if assets.has_demos(task)])
    parser.add_argument("forward", type=Path, help="a recording of the release: a pickle, or an npz of its arrays")
    parser.add_argument("--backward", type=Path)
    arguments = parser.parse_args()
    files = {"forward": arguments.forward, "backward": arguments.backward}
    try:
        demos = with_recordings(arguments.task, {direction: file for direction, file in files.items() if file})
    except (InputError, OSError) as error:
        parser.error(str(error))
    target = FOLDER / f"{arguments.task}.npz"
    target.parent.mkdir(exist_ok=True)
    save(demos, target)
    print(f"{target}: " + ", ".join(f"{int(part.ends.sum())} {direction}" for direction, part in demos.items()))


if __name__ == "__main__":
    main()
