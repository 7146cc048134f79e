"""Registries from names to dataclasses: the package's own table, entry points of other packages, registered classes."""

import dataclasses
import functools
from importlib import metadata
from typing import Any

from earl_jax.errors import InputError


class Registry:
    """The names of one kind (`env`, `algo`) and their classes, extended by the entry-point group `earl_jax.<kind>s`.

    Listing names imports nothing. A broken package therefore raises an error only when its name is used.
    """

    def __init__(self, kind: str, table: dict[str, str]):
        self.kind = kind
        self._table: dict[str, Any] = dict(table)

    def _entry_points(self) -> list[metadata.EntryPoint]:
        return list(metadata.entry_points(group=f"earl_jax.{self.kind}s"))

    @functools.cached_property
    def _conflicting_entry_points(self) -> list[metadata.EntryPoint]:
        """Entry points with a name of the table. Cached, because a search reads the metadata of every package."""
        return [point for point in self._entry_points() if point.name in self._table]

    def names(self) -> list[str]:
        """Return every name that can be built, sorted."""
        return sorted({*self._table, *(point.name for point in self._entry_points())})

    def register(self, name: str, factory: type) -> None:
        """Add the dataclass `factory` under `name`.

        Raises:
            ValueError: the name is taken, `factory` is not a dataclass, or its `name` differs.
        """
        if name in self.names():
            raise InputError(f"{self.kind} {name!r} exists already; choose another name")
        self._table[name] = self._checked(name, factory, "the registered class")

    def get(self, name: str) -> type:
        """Return the dataclass of `name`.

        Raises:
            ValueError: as `locate`, or the entry point of the name cannot be loaded.
        """
        target, _ = self.locate(name)
        if isinstance(target, metadata.EntryPoint):
            return target.load() if name in self._table else self._loaded(target)
        return target

    def locate(self, name: str) -> tuple[metadata.EntryPoint | type, str]:
        """Return where the class of `name` is, or the class if it was registered, and the package that brings it.

        Nothing is imported.

        Raises:
            ValueError: the name is unknown (the message lists the choices) or claimed by several packages.
        """
        known = isinstance(name, str) and name in self._table
        candidates = self._conflicting_entry_points if known else self._entry_points()
        points = [point for point in candidates if point.name == name]
        owners = ["earl_jax"] * known + [_owner(point) for point in points]
        if len(owners) > 1:
            raise InputError(
                f"{self.kind} {name!r} is claimed by {' and '.join(owners)}; rename the entry point or uninstall one"
            )
        if points:
            return points[0], owners[0]
        if not known:
            own = f"your own needs register_{self.kind} in this process or an entry point, see docs/extending.md"
            raise InputError(f"unknown {self.kind} {name!r}; choose from {', '.join(self.names())} ({own})")
        target = self._table[name]
        return metadata.EntryPoint(name, target, self.kind) if isinstance(target, str) else target, owners[0]

    def _loaded(self, point: metadata.EntryPoint) -> type:
        """Return the class of an entry point. Any error in its package becomes a ValueError that names the package."""
        try:
            factory = point.load()
        except Exception as error:
            cause = f"{type(error).__name__}: {error}"
            raise InputError(f"{self.kind} {point.name!r} of {_owner(point)} cannot be loaded: {cause}") from error
        return self._checked(point.name, factory, f"{point.value} of {_owner(point)}")

    def _checked(self, name: str, factory: Any, source: str) -> type:
        """Return `factory`, which comes from `source`, if it is a dataclass with the name `name`."""
        if not isinstance(factory, type) or not dataclasses.is_dataclass(factory):
            raise InputError(f"{self.kind} {name!r}: {source} must be a dataclass, not {factory!r}")
        own = getattr(factory, "name", None)
        if own != name:
            raise InputError(
                f"{self.kind} {name!r}: {source} has the name {own!r}, which run folders would store; rename one"
            )
        return factory

    def build(self, name: str, options: dict[str, Any]) -> Any:
        """Return an object of the class of `name` with `options`.

        Raises:
            ValueError: as `get`; or an option is unknown or has the wrong type.
        """
        from earl_jax.options.values import check  # loads numpy, which listing does not need

        factory = self.get(name)
        check(f"{self.kind} {name!r}", factory, options)
        return factory(**options)


def _owner(point: metadata.EntryPoint) -> str:
    """Return the name and version of the package that an entry point belongs to."""
    return f"{point.dist.name} {point.dist.version}" if point.dist else "another package"
