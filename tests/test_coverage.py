"""docs/developers/coverage.md names objects, files and options that exist, and the paper's numbers are those of the code.

The links of the page are checked with those of all pages, in tests/test_docs.py.
"""

import dataclasses
import importlib
import re
from collections import Counter
from typing import Any, NamedTuple

import pytest

from earl_jax import algos, assets, envs, protocol
from earl_jax.cli.arguments import parse_options
from tests.test_docs import DOCS, PAGES, ROOT, table_rows

PAGE = DOCS / "developers" / "coverage.md"
CLASSES = ("same", "differs", "option", "open")
OBJECT, OPTION, FILE = r"[\w.]*:[\w.]+", r"([a-z]\w*): (\w+)=(\S+)", r"assets/[\w./]+"
LINK = r"\]\([\w./]+\.md[#\w-]*\)"


class Item(NamedTuple):
    """A row of the tables: the paper's statement, the code in backticks, and its class with a remark."""

    statement: str
    where: str
    here: str

    @property
    def kind(self) -> str:
        """The class, the first word of the last cell."""
        return re.split(r"\W", self.here)[0]


def items_of(text: str) -> list[Item]:
    """Return the items of a page of coverage; comments in it are left out. A row must have the cells of an item."""
    text = re.sub(r"<!--.*?-->", "", text)
    return [Item(*cells) for first in ("paper", "promise") for cells in table_rows(text, first)]


def attribute(path: str) -> Any:
    """Return the object `module:name`; a field without a default returns its declaration."""
    module, names = path.split(":")
    found = importlib.import_module(module)
    for name in names.split("."):
        declared = dataclasses.fields(found) if dataclasses.is_dataclass(found) else ()
        field = next((field for field in declared if field.name == name), None)
        found = field if field and not hasattr(found, name) else getattr(found, name)
    return found


def build(name: str, field: str, value: str) -> Any:
    """Return the task, method or setting `name` with one option."""
    for names, make in ((envs.list_envs(), envs.make), (algos.list_algos(), algos.make_algo)):
        if name in names:
            return make(name, **parse_options((f"{field}={value}",)))
    return protocol.setting_of(name, **parse_options((f"{field}={value}",)))


def fault_of_reference(text: str) -> str | None:
    """Return what is wrong with a reference, the text between two backticks; None if it is an object, option or file."""
    option = re.fullmatch(OPTION, text)
    try:
        if re.fullmatch(OBJECT, text):
            attribute(f"earl_jax.{text}".replace(".:", ":"))
        elif option:
            build(*option.groups())
        elif not (re.fullmatch(FILE, text) and (ROOT / text).is_file()):
            return f"{text} is no object, option or file"
    except (ImportError, AttributeError, ValueError) as error:
        return f"{text}: {error}"
    return None


def faults(text: str) -> list[str]:
    """Return everything that is wrong with the items of a page, and with its counts of them."""
    items, wrong = items_of(text), []
    for item in items:
        references = re.findall(r"`([^`]+)`", item.where)
        if item.kind not in CLASSES:
            wrong.append(f"{item.statement} has the class {item.kind!r}, not one of {', '.join(CLASSES)}")
        if not references and item.kind != "open":
            wrong.append(f"{item.statement} names no code")
        if re.sub(r"`[^`]+`|[, ]", "", item.where) not in ("", "-"):
            wrong.append(f"{item.statement}: {item.where} has more than references in backticks")
        if (item.kind == "option") != any(re.fullmatch(OPTION, reference) for reference in references):
            wrong.append(f"{item.statement}: an option is named in rows of the class option only")
        if item.kind == "differs" and not re.search(LINK, item.here):
            wrong.append(f"{item.statement} differs without a link to the place that says why")
        if item.kind != "same" and item.here == item.kind:
            wrong.append(f"{item.statement} has no remark")
        wrong += filter(None, map(fault_of_reference, references))
    counts = dict(Counter(item.kind for item in items))
    stated = {kind: int(number) for kind, number in re.findall(rf"({'|'.join(CLASSES)}) \((\d+) rows", text)}
    if stated != counts:
        wrong.append(f"the counts of the page are {stated}, those of its items {counts}")
    return wrong


def test_the_page_names_what_exists_and_counts_right():
    assert faults(PAGE.read_text()) == []


def test_every_part_of_the_page_has_items_and_its_links_are_checked():
    parts = re.split(r"^### ", PAGE.read_text(), flags=re.MULTILINE)[1:]
    assert [part.splitlines()[0] for part in parts if not items_of(part)] == []
    assert PAGE in PAGES


NUMBERS = {
    "earl_jax.algos:SAC.learning_rate": 3e-4,
    "earl_jax.algos:SAC.discount": 0.99,
    "earl_jax.algos:SAC.target_rate": 0.005,
    "earl_jax.algos:SAC.batch_size": 256,
    "earl_jax.algos:SAC.hidden_sizes": (256, 256),
    "earl_jax.algos:SAC.random_steps": 1_000,
    "earl_jax.algos:SAC.timeout_bootstrap": False,
    "earl_jax.algos:SAC.demo_share": 0.0,
    "earl_jax.algos.learner.networks:LOG_STD_RANGE": (-20.0, 2.0),
    "earl_jax.algos.naive:Naive.episode_length": 1_000,
    "earl_jax.algos.r3l:R3L.rnd_decay": 0.99,
    "earl_jax.algos.r3l:_NETWORK.layer_sizes": (256, 256, 512),
    "earl_jax.protocol:Protocol.intervention_chance": 0.0,
    "earl_jax.envs.tabletop:TOLERANCE": 0.2,
    "earl_jax.envs.dhand.observation:FINGERS": 16,
    "earl_jax.envs.dhand.observation:ARM": 7,
    "earl_jax.envs.minitaur.motors:MOTORS": 8,
    "earl_jax.envs.minitaur.pen:EFFORT": {"released": -0.005 * 0.002, "paper": 0.02},
    "earl_jax.paper.figure2:HORIZONS": (1_000, 2_000, 5_000, 10_000, 20_000, 100_000, 200_000),
    "earl_jax.paper.artefact:METHODS": ("naive", "fbrl", "r3l", "vaprl", "oracle"),
    "earl_jax.paper.figure3:TASKS": ("tabletop_organization", "sawyer_peg", "minitaur_pen"),
    "earl_jax.paper.figure4:METHODS": ("fbrl", "vaprl", "oracle"),
    "earl_jax.paper.figure2:TASKS": ("cheetah_run", "fish_swim"),
}
"""Numbers and lists of the paper, by the object that has them."""


@pytest.mark.parametrize("path", NUMBERS)
def test_the_code_has_a_number_of_the_paper(path):
    assert attribute(path) == NUMBERS[path]


def test_counts_and_steps_of_the_paper_are_those_of_the_files_and_the_code():
    demos = envs.make("tabletop_organization").demonstrations.load("forward")
    assert sum(map(len, attribute("earl_jax.envs.kitchen.reward:COMPONENTS"))) == 14
    assert list(Counter(map(tuple, demos.goals[demos.ends])).values()) == [3, 3, 3, 3]
    steps = [int(row["low"]) for row in assets.published("steps")]
    assert steps == [2_500_000, 4_000_000, 4_300_000, 5_000_000, 5_000_000, 3_000_000]
    assert [len(assets.published(name)) for name in ("table1", "table2")] == [27, 21]
    drops = {row["algo"]: row["drop_percent"] for row in assets.published("figure4")}
    assert drops == {"oracle": "37.4", "fbrl": "14.3", "vaprl": "2"}
