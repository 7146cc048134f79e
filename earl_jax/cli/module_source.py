"""The parsed source of Python modules: definitions through imports, and the values of constants. Nothing is run.

`earl-jax list` reads classes this way because importing them imports jax, which takes seconds.
"""

import ast
import functools
import importlib.util
import operator
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

OPERATORS = {ast.Add: operator.add, ast.Sub: operator.sub, ast.Mult: operator.mul, ast.Pow: operator.pow}
INTERVALS = {"within", "Interval"}
"""Functions of `earl_jax.options` whose argument is the interval of an option."""
DEEPEST = 20
"""Imports that lead from a name to its definition, at most."""
OWN = __name__.partition(".")[0]


class UnknownError(Exception):
    """The source alone does not give a value."""


class Module:
    """The parsed source of one module: `tree`, and the definitions at its top level by name."""

    def __init__(self, name: str, path: Path):
        self.name, self.path, self.tree = name, path, ast.parse(path.read_bytes())
        self.definitions: dict[str, ast.stmt] = {}
        self.imports: dict[str, tuple[str, str | None]] = {}
        for node in _statements(self.tree.body):
            self._add(node)

    def _add(self, node: ast.stmt) -> None:
        if isinstance(node, ast.ClassDef):
            self.definitions[node.name] = node
        elif isinstance(node, ast.Assign | ast.AnnAssign):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            self.definitions |= {target.id: node for target in targets if isinstance(target, ast.Name)}
        elif isinstance(node, ast.ImportFrom):
            source = self._absolute(node)
            self.imports |= {alias.asname or alias.name: (source, alias.name) for alias in node.names}
        elif isinstance(node, ast.Import):
            tops = {alias: alias.name.partition(".")[0] for alias in node.names}
            self.imports |= {a.asname or top: (a.name if a.asname else top, None) for a, top in tops.items()}

    def _absolute(self, node: ast.ImportFrom) -> str:
        if not node.level:
            return node.module or ""
        is_package = self.path.name == "__init__.py"
        parts = self.name.split(".")
        kept = parts[: len(parts) - node.level + is_package]
        return ".".join([*kept, *([node.module] if node.module else [])])

    def find(self, name: str, depth: int = 0) -> tuple["Module", ast.stmt] | None:
        """Return the definition of `name` and its module, through the imports that lead to it; None if there is none."""
        if name in self.definitions:
            return self, self.definitions[name]
        if name not in self.imports or depth > DEEPEST:
            return None
        source, inner = self.imports[name]
        other = self._module(source) if inner else None
        return other.find(inner, depth + 1) if other and inner else None

    def module_at(self, name: str) -> "Module | None":
        """Return the module that `name` stands for here, if it is an imported module."""
        if name not in self.imports:
            return None
        source, inner = self.imports[name]
        return self._module(source if inner is None else f"{source}.{inner}")

    def _module(self, name: str) -> "Module | None":
        """Return the module `name` if it belongs to earl_jax or to the package of this module; others are not read."""
        return module_of(name) if name.partition(".")[0] in (OWN, self.name.partition(".")[0]) else None

    def definition(self, node: ast.expr) -> tuple["Module", ast.stmt] | None:
        """Return what the expression `node`, a name or `module.name`, refers to."""
        if isinstance(node, ast.Name):
            return self.find(node.id)
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
            module = self.module_at(node.value.id)
            return module.find(node.attr) if module else None
        return None

    def value(self, node: ast.expr, names: Mapping[str, ast.expr] | None = None) -> Any:
        """Return the value of the expression `node`: literals, constants of modules, those in `names`, sums of them.

        Raises:
            UnknownError: it needs more than that.
        """
        try:
            return self._value(node, names)
        except (TypeError, LookupError, ArithmeticError, RecursionError) as error:
            raise UnknownError(ast.unparse(node)) from error

    def _value(self, node: ast.expr, names: Mapping[str, ast.expr] | None) -> Any:
        match node:
            case ast.Constant():
                return node.value
            case ast.Tuple() | ast.List():
                return [self.value(item, names) for item in node.elts]
            case ast.UnaryOp(op=ast.USub()):
                return -self.value(node.operand, names)
            case ast.BinOp() if type(node.op) in OPERATORS:
                return OPERATORS[type(node.op)](self.value(node.left, names), self.value(node.right, names))
            case ast.JoinedStr():
                return "".join(str(self.value(part, names)) for part in node.values)
            case ast.FormattedValue():
                return self.value(node.value, names)
            case ast.Subscript(slice=ast.Constant(value=int(index))):
                return self.value(node.value, names)[index]
            case ast.Call() if called(node) in INTERVALS and node.args:
                return self.value(node.args[0], names)
        return self._constant(node, names)

    def constant(self, name: str) -> Any:
        """Return the constant `name` of this module. Errors as `value`."""
        return self.value(ast.Name(name))

    def _constant(self, node: ast.expr, names: Mapping[str, ast.expr] | None) -> Any:
        if names and isinstance(node, ast.Name) and node.id in names:
            return self.value(names[node.id])
        module, statement = self.definition(node) or (self, None)
        if isinstance(statement, ast.Assign | ast.AnnAssign) and statement.value is not None:
            return module.value(statement.value)
        raise UnknownError(ast.unparse(node))


@functools.cache
def module_of(name: str) -> Module | None:
    """Return the parsed module `name`; None if its source is not found or not Python."""
    path = _path_of(name)
    try:
        return Module(name, path) if path else None
    except (OSError, SyntaxError, ValueError):
        return None


def _path_of(name: str) -> Path | None:
    """Return the file of the module `name`; only the finders of its top-level package are asked, so nothing is imported."""
    top, *rest = name.split(".")
    try:
        spec = getattr(sys.modules.get(top), "__spec__", None) or importlib.util.find_spec(top)
    except (ImportError, ValueError):
        return None
    if spec is None:
        return None
    if not rest:
        return Path(spec.origin) if spec.origin and spec.origin.endswith(".py") else None
    folders = [Path(folder).joinpath(*rest) for folder in spec.submodule_search_locations or []]
    files = [file for folder in folders for file in (folder / "__init__.py", folder.with_suffix(".py"))]
    return next((file for file in files if file.is_file()), None)


def called(node: ast.Call) -> str:
    """Return the name of the function that `node` calls, without its module."""
    return ast.unparse(node.func).rpartition(".")[2]


def _statements(body: list[ast.stmt]) -> Iterator[ast.stmt]:
    """Yield the statements of `body`, with those under `if` and `try`."""
    for node in body:
        yield node
        for inner in ("body", "orelse", "handlers", "finalbody"):
            if isinstance(node, ast.If | ast.Try | ast.ExceptHandler) and getattr(node, inner, None):
                yield from _statements(getattr(node, inner))
