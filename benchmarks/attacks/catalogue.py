"""All cases by class."""

from collections.abc import Callable, Sequence

from benchmarks.attacks import (
    arguments,
    checkpoints,
    configs,
    disks,
    divergence,
    folders,
    links,
    metrics_files,
    plugins,
    processes,
    programs,
    recordings,
    reports,
    signals,
)  # fmt: skip
from benchmarks.attacks.case import Case

CLASSES: dict[str, Callable[[], list[Case]]] = {
    "recordings": recordings.cases,
    "links": links.cases,
    "arguments": arguments.cases,
    "config.json": configs.cases,
    "metrics.csv": metrics_files.cases,
    "checkpoints": checkpoints.cases,
    "divergence": divergence.cases,
    "plugins": plugins.cases,
    "signals": signals.cases,
    "disks": disks.cases,
    "programs": programs.cases,
    "processes": processes.cases,
    "folders": folders.cases,
    "reports": reports.cases,
}


def select(classes: Sequence[str] = (), fast: bool = False, text: str = "") -> list[tuple[str, Case]]:
    """Return the cases of `classes` (all by default) with their class; only `fast` ones, only those whose name has `text`."""
    chosen = [(kind, case) for kind in classes or CLASSES for case in CLASSES[kind]()]
    return [(kind, case) for kind, case in chosen if (case.fast or not fast) and text in case.name]
