"""The README and the pages of docs/: links, tables of numbers, and code."""

import dataclasses
import operator
import re
import tomllib
from pathlib import Path

import pytest

import earl_jax
from earl_jax import algos, envs
from tests.conftest import own_algos

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
PAGES = sorted([ROOT / "README.md", *DOCS.rglob("*.md"), *ROOT.glob("examples/*/*.md"), *ROOT.glob("notebooks/*.py")])


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_have_a_target(page):
    for target in re.findall(r"\]\(([^)\s]+)\)", page.read_text()):
        if target.startswith("http"):
            continue
        path, _, anchor = target.partition("#")
        file = (page.parent / path) if path else page
        assert file.exists(), target
        if anchor:
            titles = re.findall(r"^#+ (.*)", file.read_text(), flags=re.MULTILINE)
            assert anchor in [re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-") for title in titles], target


def table_rows(text, first):
    """Return the rows of the tables whose header begins with `first`, as lists of cells."""
    tables = re.findall(rf"^\| {re.escape(first)} \|.*\n\|[-| ]*\n((?:\|.*\n)+)", text, flags=re.MULTILINE)
    return [[cell.strip() for cell in row.strip("|").split(" | ")] for table in tables for row in table.splitlines()]


@pytest.mark.parametrize("cls", [algos.Learner, algos.SAC, algos.TD3, *map(algos.ALGOS.get, own_algos())])
def test_the_page_of_methods_has_every_hyper_parameter(cls):
    page = (DOCS / "methods.md").read_text()
    fields = {field.name: repr(field.default) for field in dataclasses.fields(cls)}
    elsewhere = {"learner"} | (set() if cls is algos.Learner else set(algos.Learner.__dataclass_fields__))
    defaults = {row[0].strip("`"): row[1].replace('"', "'") for row in table_rows(page, f"field of `{cls.__name__}`")}
    assert defaults == {name: default for name, default in fields.items() if name not in elsewhere}


def test_the_page_of_tasks_has_the_numbers_of_every_task():
    numbers = operator.attrgetter(
        "observation_size", "action_size", "train_horizon", "eval_horizon", "continuing.goal_change"
    )
    rows = {row[0].strip("`"): row[1:6] for row in table_rows((DOCS / "tasks.md").read_text(), "task")}
    assert rows == {name: [f"{number:,}" for number in numbers(envs.make(name))] for name in envs.list_envs()}


RUN_ELSEWHERE = {"adapters", "custom_loops", "extending"}
TOO_LONG = {"README"}
CODE = {
    page.stem: blocks
    for page in sorted(DOCS.glob("*.md"))
    if (blocks := re.findall(r"```python\n(.*?)```", page.read_text(), flags=re.DOTALL))
    and page.stem not in RUN_ELSEWHERE | TOO_LONG
}


@pytest.mark.slow
@pytest.mark.parametrize("page", CODE)
def test_the_code_of_a_page_runs_and_writes_nothing(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for block in CODE[page]:
        exec(compile(block, page, "exec"), {})
    assert not list(tmp_path.iterdir())


def test_the_gallery_lists_the_policies_that_ship_and_their_success_in_small_videos():
    page = (DOCS / "pictures.md").read_text()
    listed = {row[0].strip("`"): re.findall(r"`(\w+)`", row[1]) for row in table_rows(page, "task") if len(row) == 2}
    shipped = earl_jax.list_pretrained()
    assert {task: listed.get(task) for task in shipped} == shipped
    for task, method, success in re.findall(r"\(tasks.md#(\w+)\) \| (\w+), (\d\.\d+)", page):
        info = earl_jax.pretrained_info(task, method.lower())
        assert f"{info['deployed/success'][0]:.2f}" == success
        assert (DOCS / "pictures" / "gallery" / f"{task}_{method.lower()}.webp").stat().st_size < 300_000
    assert sum(path.stat().st_size for path in (DOCS / "pictures" / "gallery").iterdir()) < 3_000_000


def test_only_pyproject_has_the_address_and_install_lines_need_no_index():
    """The package is on no index yet; docs/contributing.md says what changes then."""
    code = [path for folder in ("earl_jax", "notebooks", "docs", ".github") for path in (ROOT / folder).rglob("*")]
    files = [path for path in [*PAGES, *code] if path.suffix in {".py", ".md", ".ipynb", ".yml", ".html"}]
    texts = {path.relative_to(ROOT).as_posix(): path.read_text() for path in files}
    assert [name for name, text in texts.items() if re.search(r"OWNER|github\.com/[\w-]+/earl_jax\b", text)] == []
    assert (ROOT / "pyproject.toml").read_text().count('/earl_jax"') == 1
    lines = [(name, line) for name, text in texts.items() for line in re.findall(r"pip install '?earl-jax.*", text)]
    assert {name for name, line in lines if " @ git+" not in line} <= {"docs/getting_started.md"}


def test_the_first_page_has_every_extra():
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    rows = [row[0] for row in table_rows((DOCS / "getting_started.md").read_text(), "extra")]
    assert {name for cell in rows for name in re.findall(r"`(\w+)`", cell)} == set(extras)


TRAINS = re.compile(r"\btrain\(|lifetime\)\(|earl-jax (?:train|sweep|search|reproduce)\b")


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_what_trains_says_how_long_it_takes_on_two_cores_and_on_an_h200(page):
    """A page names both machines beside its first block that trains."""
    text = page.read_text()
    blocks = re.finditer(r"```(?:python|sh)\n(.*?)```", text, flags=re.DOTALL)
    first = next((block for block in blocks if TRAINS.search(block[1])), None)
    if first is None:
        return
    beside = text[max(0, first.start() - 700) : first.end() + 500]
    assert "two cores" in " ".join(beside.split())
    assert "H200" in beside
