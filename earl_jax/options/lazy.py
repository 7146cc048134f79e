"""Names of a package that are loaded on first use."""

import importlib
from collections.abc import Callable
from typing import Any


def attributes(package: str, names: dict[str, str]) -> Callable[[str], Any]:
    """Return the `__getattr__` of `package`, which has the `names`, separated by spaces, of each of these modules in it."""
    home = {name: module for module, own in names.items() for name in own.split()}

    def load(name: str) -> Any:
        if name in home:
            return getattr(importlib.import_module(f"{package}.{home[name]}"), name)
        raise AttributeError(f"module {package!r} has no attribute {name!r}")

    return load
