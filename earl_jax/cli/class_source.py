"""What the source of a dataclass says about it: docstring, options with defaults and meaning, constants."""

import ast
import contextlib
import functools
from typing import Any, NamedTuple

from earl_jax.cli.module_source import Module, UnknownError, called, module_of


class Field(NamedTuple):
    """An option of a class, as its source has it: the nodes of the annotation and the default, and the docstring below."""

    annotation: ast.expr
    default: ast.expr | None
    meaning: str
    owner: "ClassSource"

    @property
    def type(self) -> str:
        """The annotation as it is written."""
        return ast.unparse(self.annotation)

    @property
    def value(self) -> Any:
        """The default; its source text where that is no plain value, None without one."""
        node = keyword_of(self.default, "default")
        if node is None:
            return None
        try:
            return self.owner.module.value(node, self.owner.constants)
        except UnknownError:
            return ast.unparse(node)

    @property
    def interval(self) -> str | None:
        """The interval of the valid values, such as `[0, 1)`, if the metadata declares one."""
        metadata = keyword_of(self.default, "metadata")
        if metadata is None or metadata is self.default:
            return None
        try:
            return self.owner.module.value(metadata, self.owner.constants)
        except UnknownError:
            return None


class ClassSource:
    """A class in the source of `module`, with its bases of the same packages: docstrings, fields and constants."""

    def __init__(self, module: Module, node: ast.ClassDef):
        self.module, self.node = module, node
        self.own_fields: dict[str, Field] = {}
        self.constants: dict[str, ast.expr] = {}
        for statement, following in zip(node.body, [*node.body[1:], None], strict=True):
            self._add(statement, following)

    def _add(self, statement: ast.stmt, following: ast.stmt | None) -> None:
        if isinstance(statement, ast.Assign):
            self.constants |= {t.id: statement.value for t in statement.targets if isinstance(t, ast.Name)}
        if not isinstance(statement, ast.AnnAssign) or not isinstance(statement.target, ast.Name):
            return
        name = statement.target.id
        if "ClassVar" in ast.unparse(statement.annotation):
            if statement.value is not None:
                self.constants[name] = statement.value
        elif not _is_hidden(statement.value):
            self.own_fields[name] = Field(statement.annotation, statement.value, _text(following), self)

    @functools.cached_property
    def lineage(self) -> "list[ClassSource]":
        """This class, then its bases, nearest first."""
        definitions = [self.module.definition(base) for base in self.node.bases]
        bases = [
            ClassSource(module, node) for module, node in filter(None, definitions) if isinstance(node, ast.ClassDef)
        ]
        return [self, *dict.fromkeys(cls for base in bases for cls in base.lineage)]

    @property
    def docstring(self) -> str:
        """The docstring of this class, or of the nearest base that has one."""
        return next(filter(None, (ast.get_docstring(cls.node) for cls in self.lineage)), "")

    @property
    def docstrings(self) -> list[str]:
        """The docstrings of this class and its bases, nearest first."""
        return [text for cls in self.lineage if (text := ast.get_docstring(cls.node))]

    def is_a(self, name: str) -> bool:
        """Return whether this class or one of its bases is called `name`."""
        return any(cls.node.name == name for cls in self.lineage)

    def fields(self) -> dict[str, Field]:
        """Return the options by name, those of the bases first; a default without a docstring keeps the base's."""
        fields: dict[str, Field] = {}
        for cls in reversed(self.lineage):
            for name, field in cls.own_fields.items():
                earlier = fields.get(name)
                fields[name] = field if field.meaning or not earlier else field._replace(meaning=earlier.meaning)
        return fields

    def constant(self, name: str, default: Any = None) -> Any:
        """Return the class constant `name`, or the value that a property of this name returns; else `default`."""
        for cls in self.lineage:
            node = cls.constants.get(name) or _returned(cls.node, name)
            if node is not None:
                try:
                    return cls.module.value(node, cls.constants)
                except UnknownError:
                    return default
        return default

    def choices(self) -> dict[str, list[Any]]:
        """Return the valid values of the options that `_require_choice` checks, by option."""
        choices = {}
        for cls in reversed(self.lineage):
            for node in ast.walk(cls.node):
                if isinstance(node, ast.Call) and called(node) == "_require_choice":
                    with contextlib.suppress(UnknownError):
                        option, values = (cls.module.value(argument, cls.constants) for argument in node.args)
                        choices[option] = list(values)
        return choices


def class_at(target: str) -> ClassSource | None:
    """Return the class at `module:name`, read from its source; None where there is no source or no such class."""
    name, _, attribute = target.partition(":")
    module = module_of(name)
    definition = module.find(attribute) if module else None
    if definition is None or not isinstance(definition[1], ast.ClassDef):
        return None
    return ClassSource(definition[0], definition[1])


def keyword_of(node: ast.expr | None, keyword: str) -> ast.expr | None:
    """Return the argument `keyword` of a call of `field`; of another expression, itself; None without one."""
    if not isinstance(node, ast.Call) or called(node) != "field":
        return node
    return next((word.value for word in node.keywords if word.arg == keyword), None)


def _is_hidden(node: ast.expr | None) -> bool:
    """Return whether a field is none of the options: `init=False`."""
    hidden = keyword_of(node, "init")
    return isinstance(hidden, ast.Constant) and hidden is not node and hidden.value is False


def _text(statement: ast.stmt | None) -> str:
    """Return the docstring that `statement` is, on one line; "" for another statement."""
    if isinstance(statement, ast.Expr) and isinstance(statement.value, ast.Constant):
        return " ".join(str(statement.value.value).split())
    return ""


def _returned(node: ast.ClassDef, name: str) -> ast.expr | None:
    """Return the expression that the property `name` of a class returns, if its body is that alone."""
    for method in node.body:
        if isinstance(method, ast.FunctionDef) and method.name == name and isinstance(method.body[-1], ast.Return):
            return method.body[-1].value
    return None
