"""Copy runs that another machine trained into benchmarks/results/paper, where `python -m benchmarks.redraw` reads them.

    python -m benchmarks.collect FOLDER... --commit COMMIT [--to DIR]

FOLDER is the folder of a sweep, or of a run. A run becomes DIR/TASK/METHOD/VARIANT, where VARIANT names the options that
differ from the task's and the paper's in bf16, and its seeds if they do not start at 0; a run without such options is the cell
itself. Of two runs with one name, the one with more steps stays, and of equal ones that with more seeds. policies.npz comes
along for cells, and for variants of the published length.
"""

import argparse
import json
import re
import shutil
from pathlib import Path
from typing import Any

from earl_jax.envs import PAPER_TASKS
from earl_jax.errors import InputError
from earl_jax.paper.tasks import training_steps
from earl_jax.report.runs import Curves, find_runs, read
from earl_jax.runs.config import RunConfig
from earl_jax.runs.contents import CONFIG, METRICS, POLICIES
from earl_jax.runs.files import write_atomically

PAPER = Path(__file__).parent / "results" / "paper"
PRECISION = "bf16"
LARGEST_POLICIES = 4 << 20
"""Bytes of the largest policies.npz that is kept; those of ten seeds with the paper's networks are 2.8 MB."""
COMMIT = re.compile(r"[0-9a-f]{40}")


def collect(folders: list[Path], commit: str | None = None, to: Path = PAPER) -> list[tuple[str, int, str]]:
    """Return name, steps and what was done for each run in and below `folders`.

    Args:
        folders: folders of sweeps or runs.
        commit: the commit that trained those runs whose config.json names none.
        to: the folder that receives TASK/METHOD/VARIANT.

    Raises:
        ValueError: a folder holds no run, or a run names no commit and `commit` is not one; nothing was copied.
    """
    if commit is not None and not COMMIT.fullmatch(commit):
        raise InputError(f"a commit has 40 hexadecimal digits, not {commit!r}: git rev-parse HEAD prints it")
    found = [(path, _readable(path)) for path in find_runs(folders)]
    configs = {path: _config_text(path, commit) for path, curves in found if curves is not None}
    lines = []
    for path, curves in found:
        if curves is None:
            lines.append((str(path), 0, "left out: no evaluation"))
            continue
        name = run_name(curves.config)
        lines.append((name, int(curves.steps[-1]), _take(path, curves, configs[path], to / name)))
    return lines


def run_name(config: RunConfig) -> str:
    """Return TASK/METHOD, or TASK/METHOD/VARIANT for a run with options or seeds of its own."""
    setting = {key: value for key, value in config.setting.items() if key != "name"}
    options = {"precision": "tf32", **config.env_options, **setting, **config.options}
    usual = {"precision": PRECISION, "reward_scale": config.build_env().reward_scale}
    parts = [_part(option, value) for option, value in sorted(options.items()) if usual.get(option) != value]
    if min(config.seeds) > 0:
        parts.append(f"seeds_{min(config.seeds)}_to_{max(config.seeds)}")
    return "/".join([config.env, config.algo, *(["-".join(parts)] if parts else [])])


def _part(option: str, value: Any) -> str:
    """Return an option as part of a folder's name; a file by the folder that it is in."""
    if isinstance(value, bool):
        return option if value else f"no_{option}"
    if isinstance(value, str) and "/" in value:
        value = Path(value).parent.name
    text = "x".join(map(str, value)) if isinstance(value, list | tuple) else f"{value}".removesuffix(".0")
    return re.sub(r"[^A-Za-z0-9._]", "_", text if option == "precision" else f"{option}_{text}")


def _readable(path: Path) -> Curves | None:
    """Return the curves of a run folder, or None if it has no evaluation yet."""
    return read(path) if (path / METRICS).is_file() and (path / METRICS).read_text().count("\n") > 1 else None


def _config_text(path: Path, commit: str | None) -> str:
    """Return the config of the run in `path` as text that names its commit."""
    values = json.loads((path / CONFIG).read_text())
    provenance = values.setdefault("provenance", {})
    provenance["commit"] = provenance.get("commit") or commit
    if provenance["commit"] is None:
        raise InputError(f"{path} names no commit; give it with --commit")
    return json.dumps(values, indent=2) + "\n"


def _take(path: Path, curves: Curves, config: str, target: Path) -> str:
    """Copy the run in `path` to `target` unless a longer one is there, and return what was done."""
    if (target / METRICS).is_file():
        kept = read(target)
        if (int(kept.steps[-1]), kept.seeds) >= (int(curves.steps[-1]), curves.seeds):
            return f"left out: {target} has {int(kept.steps[-1])} steps of {kept.seeds} seeds"
    target.mkdir(parents=True, exist_ok=True)
    write_atomically(target / CONFIG, config)
    shutil.copyfile(path / METRICS, target / METRICS)
    (target / POLICIES).unlink(missing_ok=True)
    if not (path / POLICIES).is_file() or not _keeps_policies(curves):
        return "taken"
    if (path / POLICIES).stat().st_size > LARGEST_POLICIES:
        return f"taken without {POLICIES}, which is larger than {LARGEST_POLICIES >> 20} MiB"
    shutil.copyfile(path / POLICIES, target / POLICIES)
    return "taken"


def _keeps_policies(curves: Curves) -> bool:
    """Return whether the policies of a run are kept: those of a cell, and those of a variant of the published length."""
    is_cell = run_name(curves.config).count("/") == 1
    return is_cell or (curves.config.env in PAPER_TASKS and int(curves.steps[-1]) == training_steps(curves.config.env))


def main() -> None:
    """Copy the runs and print a line for each."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folders", nargs="+", type=Path, metavar="FOLDER")
    parser.add_argument("--commit", help="commit of the runs that name none, 40 digits")
    parser.add_argument("--to", type=Path, default=PAPER, help="by default benchmarks/results/paper")
    arguments = parser.parse_args()
    for name, steps, done in collect(arguments.folders, arguments.commit, arguments.to):
        print(f"{name}  {steps:,} steps  {done}")


if __name__ == "__main__":
    main()
