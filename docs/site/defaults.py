"""Values in the signatures of the reference, where the source names a constant or describes a field.

MkDocs loads this file as an extension of griffe, which reads the package without importing it.
"""

from collections.abc import Iterator
from typing import Any

import griffe

FIELDS = ("dataclasses.field", "flax.struct.field")


class Defaults(griffe.Extension):
    """Show `algo = 'fbrl'` for `algo = ALGO`, and `discount = 0.99` for `discount = struct.field(default=0.99, ...)`."""

    def on_package(self, *, pkg: griffe.Module, loader: griffe.GriffeLoader, **kwargs: Any) -> None:
        """Replace the defaults of all functions and fields of `pkg`."""
        for item in _members(pkg):
            if isinstance(item, griffe.Attribute):
                item.value = _value(item.value, loader.modules_collection)
            for parameter in item.parameters if isinstance(item, griffe.Function) else ():
                parameter.default = _value(parameter.default, loader.modules_collection)


def _members(item: Any) -> Iterator[Any]:
    for member in item.members.values():
        if not member.is_alias:
            yield member
            yield from _members(member)


def _value(source: Any, modules: griffe.ModulesCollection) -> Any:
    """Return the default of a field or the value of a constant; other expressions, and names of other packages, stay."""
    if isinstance(source, griffe.ExprCall) and source.canonical_path in FIELDS:
        given = {part.name: part.value for part in source.arguments if isinstance(part, griffe.ExprKeyword)}
        return _value(given.get("default", source), modules) if "default" in given else source
    if isinstance(source, griffe.ExprName | griffe.ExprAttribute):
        try:
            return _value(modules[source.canonical_path].value, modules) or source
        except (KeyError, AttributeError):
            return source
    return source
