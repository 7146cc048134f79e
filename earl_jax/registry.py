"""Names to dataclasses: a table in the package, entry points of other packages, and what a program registers."""

import dataclasses
import importlib
from importlib import metadata
from typing import Any


class Registry:
    """A table of names for one kind of thing (`env`, `algo`), open to the entry-point group `earl_jax.<kind>s`."""

    def __init__(self, kind: str, table: dict[str, str]):
        self.kind = kind
        self._table: dict[str, Any] = dict(table)

    def _entry_points(self) -> dict[str, metadata.EntryPoint]:
        return {point.name: point for point in metadata.entry_points(group=f"earl_jax.{self.kind}s")}

    def names(self) -> list[str]:
        """Return every name that can be built, sorted."""
        return sorted({*self._table, *self._entry_points()})

    def register(self, name: str, factory: type) -> None:
        """Add `factory` under `name`; a taken name is a ValueError."""
        if name in self.names():
            raise ValueError(f"{self.kind} {name!r} exists already")
        self._table[name] = factory

    def get(self, name: str) -> type:
        """Return the dataclass behind `name`; an unknown name is a ValueError that lists the choices."""
        if name in self._table:
            target = self._table[name]
            if isinstance(target, str):
                module, _, attribute = target.partition(":")
                return getattr(importlib.import_module(module), attribute)
            return target
        points = self._entry_points()
        if name in points:
            return points[name].load()
        raise ValueError(f"unknown {self.kind} {name!r}; choose from {', '.join(self.names())}")

    def build(self, name: str, options: dict[str, Any]) -> Any:
        """Return `name` built with `options`; an unknown option is a ValueError that lists the fields."""
        factory = self.get(name)
        known = [field.name for field in dataclasses.fields(factory)]
        for option in options:
            if option not in known:
                raise ValueError(f"{self.kind} {name!r} has no option {option!r}; choose from {', '.join(known)}")
        return factory(**options)
