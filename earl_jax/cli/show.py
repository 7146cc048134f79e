"""The command that prints what a run folder holds: show."""

import contextlib
from pathlib import Path
from typing import TYPE_CHECKING, Any

from earl_jax.cli.arguments import JSON, Last, Positional, WindowSteps, emit
from earl_jax.errors import InputError

if TYPE_CHECKING:
    from earl_jax.metrics.scores import Window
    from earl_jax.training import Result


def show(folder: Positional[Path], last: Last = None, window: WindowSteps = None, json: JSON = False) -> None:
    """Show a run: its task, method and options, the steps it has reached, its newest metrics, and its policies.

    Args:
        folder: Run folder. It needs no checkpoint.
    """
    from earl_jax.metrics.scores import Window
    from earl_jax.training.loading import policies_at
    from earl_jax.training.result import load

    result, chosen = load(folder), Window.of(last, window)
    run = result.folder
    assert run is not None
    values = {
        "folder": str(folder),
        "config": result.config.values,
        "engine": result.engine,
        "provenance": run.recorded().get("provenance"),
        "step": result.step,
        "finished": result.finished,
        "score": None,
        "policies": policies_at(run),
        "metrics": {name: numbers[:, -1].tolist() for name, numbers in result.metrics.items()},
        "load": f"earl_jax.load({str(folder)!r})",
    }
    with contextlib.suppress(InputError):  # no evaluation yet
        values["score"] = result.score(chosen)._asdict()
    emit(values, json, _text(result, values, chosen))


def _text(result: "Result", values: dict[str, Any], window: "Window") -> str:
    """Return the lines of the summary of `result`, with the mean of every metric over the seeds."""
    from earl_jax.runs.provenance import made_by
    from earl_jax.training.result import printable

    origin = values["provenance"] if isinstance(values["provenance"], dict) else {}
    texts = result.summary(window)
    del texts["metrics"]
    texts |= {
        "made by": printable(f"earl-jax {made_by(origin) or 'of an unknown version'}"),
        "policies": f"of step {values['policies']:,}" if values["policies"] else "none",
        "in Python": values["load"],
        "metrics": f"means over {len(result.seeds)} seeds at step {result.steps[-1]:,}"
        if len(result.steps)
        else "none",
    }
    lines = [f"{title + ':':<10} {text}" for title, text in texts.items()]
    means = {printable(name): numbers[:, -1].mean() for name, numbers in result.metrics.items()}
    width = max(map(len, means), default=0)
    return "\n".join([*lines, *(f"  {name:<{width}}  {mean:.6g}" for name, mean in means.items())])
