"""Names to dataclasses: a table in the package, entry points of other packages, and what a program registers."""

import dataclasses
import functools
from importlib import metadata
from typing import Any

from earl_jax import options as options_lib


class Registry:
    """A table of names for one kind of thing (`env`, `algo`), open to the entry-point group `earl_jax.<kind>s`.

    Listing names imports nothing, so a package that is broken is only told of where its name is asked for.
    """

    def __init__(self, kind: str, table: dict[str, str]):
        self.kind = kind
        self._table: dict[str, Any] = dict(table)

    def _entry_points(self) -> list[metadata.EntryPoint]:
        return list(metadata.entry_points(group=f"earl_jax.{self.kind}s"))

    @functools.cached_property
    def _claims(self) -> list[metadata.EntryPoint]:
        """Entry points that claim a name of the table, looked for once: that reads the metadata of every package."""
        return [point for point in self._entry_points() if point.name in self._table]

    def names(self) -> list[str]:
        """Return every name that can be built, sorted."""
        return sorted({*self._table, *(point.name for point in self._entry_points())})

    def register(self, name: str, factory: type) -> None:
        """Add `factory` under `name`; a taken name, or one that `factory` does not call itself, is a ValueError."""
        if name in self.names():
            raise ValueError(f"{self.kind} {name!r} exists already")
        self._table[name] = self._checked(name, factory, "what is registered")

    def get(self, name: str) -> type:
        """Return the dataclass behind `name`.

        Raises:
            ValueError: the name is unknown (the message lists the choices), claimed twice, or what another package has
                under it cannot be loaded.
        """
        known = name in self._table
        points = [point for point in (self._claims if known else self._entry_points()) if point.name == name]
        owners = ["earl_jax"] * known + [_owner(point) for point in points]
        if len(owners) > 1:
            raise ValueError(
                f"{self.kind} {name!r} is claimed by {' and '.join(owners)}; rename the entry point or uninstall one"
            )
        if points:
            return self._loaded(points[0])
        if not known:
            raise ValueError(f"unknown {self.kind} {name!r}; choose from {', '.join(self.names())}")
        target = self._table[name]
        return metadata.EntryPoint(name, target, self.kind).load() if isinstance(target, str) else target

    def _loaded(self, point: metadata.EntryPoint) -> type:
        """Return what another package has under its name; whatever goes wrong there is a ValueError that says whose it is."""
        try:
            found = point.load()
        except Exception as error:
            cause = f"{type(error).__name__}: {error}"
            raise ValueError(f"{self.kind} {point.name!r} of {_owner(point)} cannot be loaded: {cause}") from error
        return self._checked(point.name, found, f"{point.value} of {_owner(point)}")

    def _checked(self, name: str, factory: Any, what: str) -> type:
        if not isinstance(factory, type) or not dataclasses.is_dataclass(factory):
            raise ValueError(f"{self.kind} {name!r}: {what} is no dataclass but {factory!r}")
        own = getattr(factory, "name", None)
        if own != name:
            raise ValueError(f"{self.kind} {name!r}: {what} calls itself {own!r}, the name that run folders would keep")
        return factory

    def build(self, name: str, options: dict[str, Any]) -> Any:
        """Return `name` built with `options`; one that is unknown, or of another kind than the default, is a ValueError."""
        factory = self.get(name)
        options_lib.check(f"{self.kind} {name!r}", factory, options)
        return factory(**options)


def _owner(point: metadata.EntryPoint) -> str:
    """Return the name and version of the package that an entry point belongs to."""
    return f"{point.dist.name} {point.dist.version}" if point.dist else "another package"
