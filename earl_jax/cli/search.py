"""The command that searches for options: search."""

from pathlib import Path

from earl_jax.cli.arguments import JSON, Devices, Minutes, Positional, emit, parse_minutes, print_line


def search(
    space: Positional[Path],
    out: Path = Path("runs/search"),
    trials: int = 32,
    batch: int = 8,
    rungs: int = 3,
    seed: int = 0,
    devices: Devices = None,
    minutes: Minutes = None,
    json: JSON = False,
) -> None:
    """Search for the options that score highest, with Optuna, in batches of runs. After a kill, repeat the command.

    Args:
        space: Sweep file of one task and one method, in which options have distributions (docs/sweeps.md).
        out: Folder of the runs and of search.journal, which has all trials.
        trials: Number of options to try.
        batch: Number of runs that train together, as lanes of one program where only floats differ.
        rungs: Number of steps at which runs are scored; those below the median end there. 1 lets all run to their end.
        seed: Random seed of the options; the seeds of training are in the file.
    """
    limit = parse_minutes(minutes)
    from earl_jax.sweeps.search import STATES, TRIALS
    from earl_jax.sweeps.search import search as run_search

    lines: list[str] = []
    history = run_search(
        space,
        out,
        trials,
        batch,
        rungs,
        seed,
        devices=devices,
        emit=lines.append if json else print_line,
        minutes=limit,
    )
    done = [trial for trial in history if trial.state == "done"]
    best = max(done, key=lambda trial: trial.scores[max(trial.scores)], default=None)
    counts = {state: sum(trial.state == state for trial in history) for state in STATES.values()}
    text = ", ".join(f"{count} {state}" for state, count in counts.items() if count)
    if best:
        text += f"; best {best.scores[max(best.scores)]:.4g} with {best.options}"
    values = {"out": str(out), **counts, "lines": lines, "trials": [trial._asdict() for trial in history]}
    values |= {"best": best._asdict() if best else None, "stopped": counts["running"] > 0 or len(history) < trials}
    emit(values, json, f"{out / TRIALS}: {text}\nrank them with intervals and tests: earl-jax best {out}")
