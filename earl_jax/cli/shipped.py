"""What ships for a task, read from the files alone: demonstrations and trained policies. It loads no array."""

import functools
import json
import zipfile
from pathlib import Path
from typing import Any

DIRECTIONS = ("forward", "backward")
DESCRIBED = ("seeds", "step", "episodes", "deployed/success", "deployed/return")


def demonstrations(task: str) -> list[str]:
    """Return the directions of the demonstrations that ship for `task`."""
    for path in _files(f"demos/{task}.npz"):
        with zipfile.ZipFile(path) as file:
            return [direction for direction in DIRECTIONS if f"{direction}_states.npy" in file.namelist()]
    return []


def policies_of_task(task: str) -> dict[str, dict[str, Any]]:
    """Return the trained policies that ship for `task`, by method: seeds, steps, scores of the seeds, options of the run."""
    return {method: values for (name, method), values in _policies().items() if name == task}


def policies_of_method(method: str) -> dict[str, dict[str, Any]]:
    """Return the trained policies of `method` that ship, by task, as `policies_of_task` does."""
    return {task: values for (task, name), values in _policies().items() if name == method}


@functools.cache
def _policies() -> dict[tuple[str, str], dict[str, Any]]:
    """Return what is known of each trained policy that ships, by task and method."""
    policies = {}
    for path in _files("pretrained/*/*.json"):
        info = json.loads(path.read_text())
        config = info["config"]
        options = {**config["env_options"], **config["options"]}
        policies[path.parent.name, path.stem] = {**{name: info[name] for name in DESCRIBED}, "options": options}
    return policies


def _files(pattern: str) -> list[Path]:
    """Return the assets that match `pattern`, sorted; `earl_jax.assets`, which finds them too, loads NumPy."""
    package = Path(__file__).resolve().parents[1]
    folders = [folder for folder in (package / "assets", package.parent / "assets") if folder.is_dir()]
    return sorted(folders[0].glob(pattern)) if folders else []
