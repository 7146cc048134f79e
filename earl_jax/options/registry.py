"""Registries from names to dataclasses: the package's own table, entry points of other packages, registered classes."""

import dataclasses
import functools
import re
from importlib import metadata
from typing import Any

from earl_jax.errors import InputError, brief, choices, own_options
from earl_jax.options.values import check

ARGUMENTS = frozenset(
    {"env", "name", "algo", "setting", "seeds", "steps", "eval_every", "eval_episodes", "checkpoint_every"}
    | {"out", "logs", "overwrite", "progress", "devices", "minutes"}
)
"""Parameters of the functions that accept options by name; an option with such a name could not be set."""
NAME = re.compile(r"[A-Za-z][\w.-]*", re.ASCII)
"""The names that file systems and Gymnasium's ids accept."""
REGISTERED: list[type] = []
"""The classes of every kind that were registered in this process."""


class Registry:
    """The names of one kind (`env`, `algo`) and their classes, extended by the entry-point group `earl_jax.<kind>s`.

    The classes are dataclasses and subclasses of `base`; `base` and the entries of `table` are written `module:class`.

    Listing names imports nothing. A broken package therefore raises an error only when its name is used.
    """

    def __init__(self, kind: str, base: str, table: dict[str, str]):
        self.kind, self._base = kind, metadata.EntryPoint("base", base, kind)
        self.noun = {"env": "task", "algo": "method"}.get(kind, kind)  # what messages call the kind
        self._table: dict[str, str | type[Any]] = dict(table)

    def _entry_points(self) -> list[metadata.EntryPoint]:
        return list(metadata.entry_points(group=f"earl_jax.{self.kind}s"))

    @functools.cached_property
    def _conflicting_entry_points(self) -> list[metadata.EntryPoint]:
        """The entry points whose name is in the table; cached, because a search reads the metadata of every package."""
        return [point for point in self._entry_points() if point.name in self._table]

    def names(self) -> list[str]:
        """Return every name that `make` accepts, sorted."""
        return sorted({*self._table, *(point.name for point in self._entry_points())})

    def register(self, name: str, cls: type[Any]) -> None:
        """Register the dataclass `cls` as `name` in this process; `cls.name` must be the same.

        A class that is defined again, for example by running a notebook cell twice, replaces the earlier one. If an
        installed package has registered the class, nothing changes.

        Raises:
            ValueError: the name is taken, `cls` is of another kind or not a dataclass, or `cls.name` differs.
        """
        known, path = self._table.get(name), class_name(cls) if isinstance(cls, type) else None
        installed = any((point.name, point.value) == (name, path) for point in self._entry_points())
        defined_again = isinstance(known, type) and class_name(known) == path
        if name in self.names() and not (installed or defined_again):
            remedy = "choose another name, or leave out one of the two"
            raise InputError(f"{self.noun} {name!r} already exists, in {self.locate(name)[1]}; {remedy}")
        if not installed:
            self._table[name] = self._checked(name, cls, "the registered class")
        REGISTERED.append(cls)

    def get(self, name: str) -> type[Any]:
        """Return the class of `name`.

        Raises:
            ValueError: the name is unknown, or its class cannot be loaded because of an error in its package; the
                message lists the choices, or gives the cause and the package.
        """
        target, owner = self.locate(name)
        if not isinstance(target, metadata.EntryPoint):
            return target
        if name in self._table:
            return target.load()
        try:
            factory = target.load()
        except Exception as error:  # the code of another package
            cause = f"{type(error).__name__}: {error}"
            raise InputError(f"{self.noun} {name!r} of {owner} cannot be loaded: {cause}") from error
        return self._checked(name, factory, f"{target.value} of {owner}")

    def locate(self, name: str) -> tuple[metadata.EntryPoint | type[Any], str]:
        """Return the entry point of the class `name`, or the class if it was registered, and its package or module.

        Nothing is imported.

        Raises:
            ValueError: the name is unknown (the message lists the choices), or several packages claim it.
        """
        target = self._table.get(name) if isinstance(name, str) else None
        candidates = self._entry_points() if target is None else self._conflicting_entry_points
        points = [point for point in candidates if point.name == name]
        owners = [] if target is None else [target.__module__ if isinstance(target, type) else "earl_jax"]
        owners += [_owner(point) for point in points]
        if len(owners) > 1:
            raise InputError(
                f"{self.noun} {name!r} is claimed by {' and '.join(owners)}; rename the entry point or uninstall one"
            )
        if points:
            return points[0], owners[0]
        if target is None:
            yours = f"your own: --import FILE or earl_jax.register_{self.kind}, see docs/extending.md"
            raise InputError(f"unknown {self.noun} {brief(name)}; {choices(name, self.names())} ({yours})")
        return metadata.EntryPoint(name, target, self.kind) if isinstance(target, str) else target, owners[0]

    def _checked(self, name: str, factory: Any, source: str) -> type[Any]:
        """Return `factory`, which comes from `source`, if it is a dataclass of this kind with the name `name`."""
        base = self._base.load()
        if not isinstance(factory, type) or not issubclass(factory, base) or not dataclasses.is_dataclass(factory):
            kind = f"a dataclass and a subclass of {base.__name__}"
            raise InputError(f"{self.noun} {name!r}: {source} must be {kind}, not {factory!r}")
        if not NAME.fullmatch(name):
            rule = "a name has letters, digits, _, - and . only, and begins with a letter"
            raise InputError(f"{self.noun} {name!r}: {rule}")
        if missing := ", ".join(sorted(getattr(factory, "__abstractmethods__", ()))):
            raise InputError(f"{self.noun} {name!r}: {source} lacks {missing}")
        fields = {field.name for field in dataclasses.fields(factory)}
        if lost := ", ".join(sorted(own_options(factory) - fields)):
            remedy = f"decorate {factory.__name__} with @dataclasses.dataclass(frozen=True)"
            raise InputError(f"{self.noun} {name!r}: {lost} would be no option of {source}; {remedy}")
        if taken := ", ".join(sorted(ARGUMENTS & fields)):
            raise InputError(
                f"{self.noun} {name!r}: {source} has an option named like an argument of train, {taken}; rename it"
            )
        own = getattr(factory, "name", None)
        if own != name:
            raise InputError(
                f"{self.noun} {name!r}: {source} has the name {own!r}, which run folders would store; rename one"
            )
        return factory

    def make(self, /, name: str, **options: Any) -> Any:
        """Return an object of the class of `name` with these options.

        Raises:
            ValueError: the name or an option is unknown, or an option has the wrong type; the message lists the choices.
        """
        cls = self.get(name)
        check(f"{self.noun} {name!r}", cls, options)
        return cls(**options)


def class_name(cls: type) -> str:
    """Return the module and the name of a class in the form that config.json records."""
    return f"{cls.__module__}:{cls.__qualname__}"


def _owner(point: metadata.EntryPoint) -> str:
    """Return the name and version of the package that an entry point belongs to."""
    return f"{point.dist.name} {point.dist.version}" if point.dist else "another package"


ENVS = Registry(
    "env",
    "earl_jax.envs.base:Env",
    {
        "cheetah_run": "earl_jax.envs.dm_control.cheetah_run:CheetahRun",
        "dhand_lightbulb": "earl_jax.envs.dhand.lightbulb:DHandLightbulb",
        "fish_swim": "earl_jax.envs.dm_control.fish_swim:FishSwim",
        "franka_kitchen": "earl_jax.envs.kitchen.franka_kitchen:FrankaKitchen",
        "minitaur_pen": "earl_jax.envs.minitaur.pen:MinitaurPen",
        "sawyer_door": "earl_jax.envs.sawyer.door:SawyerDoor",
        "sawyer_peg": "earl_jax.envs.sawyer.peg:SawyerPeg",
        "tabletop_organization": "earl_jax.envs.tabletop:TabletopOrganization",
    },
)
ALGOS = Registry(
    "algo",
    "earl_jax.algos.method:Method",
    {
        "bc": "earl_jax.algos.bc:BC",
        "fbrl": "earl_jax.algos.fbrl:FBRL",
        "medal": "earl_jax.algos.medal:MEDAL",
        "naive": "earl_jax.algos.naive:Naive",
        "oracle": "earl_jax.algos.oracle:Oracle",
        "r3l": "earl_jax.algos.r3l:R3L",
        "risc": "earl_jax.algos.risc:RISC",
        "rlpd": "earl_jax.algos.rlpd:RLPD",
        "vaprl": "earl_jax.algos.vaprl:VaPRL",
    },
)
LEARNERS = Registry(
    "learner",
    "earl_jax.algos.learner.base:Learner",
    {"sac": "earl_jax.algos.learner.sac:SAC", "td3": "earl_jax.algos.learner.td3:TD3"},
)
LEARNER = "sac"
"""The learner that methods use by default."""
