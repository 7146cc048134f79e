"""Reinforcement learning without resets: train, look at what was learnt, reproduce the paper."""

import os
import sys
import warnings
from typing import Any

import tyro

from earl_jax.cli import demonstrations, render, report
from earl_jax.cli import inspect_runs as looking
from earl_jax.cli import train as running
from earl_jax.runs.files import DamagedWarning

PLAIN = warnings.formatwarning
COMMANDS = {
    "list": looking.list_,
    "train": running.train,
    "resume": running.resume,
    "sweep": running.sweep,
    "reproduce": running.reproduce,
    "evaluate": looking.evaluate,
    "plot": looking.plot,
    "table": looking.table,
    "render": render.render,
    "report": report.report,
    "demos": demonstrations.demos,
    "import-demos": demonstrations.import_demos,
    "quickstart": running.quickstart,
}


def _formatted(message: Warning | str, category: type[Warning], *where: Any) -> str:
    return f"earl-jax: {message}\n" if issubclass(category, DamagedWarning) else PLAIN(message, category, *where)


def main(arguments: list[str] | None = None) -> None:
    """Run one command; what the user got wrong is one line on stderr and exit code 2.

    A GPU is taken nearly whole, not three quarters of it as jax would: replays are what fills it.
    """
    warnings.formatwarning = _formatted
    os.environ.setdefault("XLA_PYTHON_CLIENT_MEM_FRACTION", "0.95")
    try:
        tyro.extras.subcommand_cli_from_dict(COMMANDS, prog="earl-jax", args=arguments, description=__doc__)
    except (ValueError, OSError) as error:
        print(f"earl-jax: {error}", file=sys.stderr)
        raise SystemExit(2) from None


if __name__ == "__main__":
    main()
