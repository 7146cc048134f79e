"""The site of the documentation, without building it: navigation, links, reference; and the workflows."""

import importlib
import re

import pytest
import yaml

import earl_jax
from docs.site import hooks
from tests.test_docs import DOCS, ROOT

REPOSITORY = "https://example.org/owner/earl_jax"
REFERENCE = sorted((DOCS / "reference").glob("*.md"))
NOTEBOOKS = sorted((ROOT / "notebooks").glob("*.py"))
WORKFLOWS = sorted((ROOT / ".github" / "workflows").glob("*.yml"))


class SiteLoader(yaml.SafeLoader):
    """Reads mkdocs.yml, whose own tags become None."""


SiteLoader.add_multi_constructor("!", lambda loader, suffix, node: None)
SiteLoader.add_multi_constructor("tag:yaml.org,2002:python/", lambda loader, suffix, node: None)


def entries(nav):
    """Return the pages of a navigation of nested lists and one-key dictionaries."""
    if isinstance(nav, str):
        return [nav]
    return [page for entry in (nav.values() if isinstance(nav, dict) else nav) for page in entries(entry)]


@pytest.fixture(scope="module")
def site():
    return yaml.load((ROOT / "mkdocs.yml").read_text(), SiteLoader)


def test_the_navigation_has_every_page_once(site):
    pages = {str(path.relative_to(DOCS)) for path in [*DOCS.glob("*.md"), *REFERENCE]}
    pages |= {"changelog.md", "notebooks/index.md", *(f"notebooks/{path.stem}.md" for path in NOTEBOOKS)}
    listed = entries(site["nav"])
    assert len(listed) == len(set(listed))
    assert set(listed) == pages


@pytest.mark.parametrize(
    ("page", "link", "expected"),
    [
        ("faq.md", "results.md#seeds", "results.md#seeds"),
        ("faq.md", "../CHANGELOG.md", "changelog.md"),
        ("changelog.md", "docs/results.md", "results.md"),
        ("README.md", "../notebooks", "notebooks/index.md"),
        ("python_api.md", "../notebooks/02_compare_two_methods.py", "notebooks/02_compare_two_methods.md"),
        ("notebooks/01_x.md", "02_y.py", "02_y.md"),
        ("notebooks/01_x.md", "01_x_1.png", "01_x_1.png"),
        ("notebooks/01_x.md", "../docs/physics.md#pure-mjx", "../physics.md#pure-mjx"),
        ("reference/index.md", "../python_api.md", "../python_api.md"),
        ("results.md", "../benchmarks/results/dense/curves.png", "benchmarks/results/dense/curves.png"),
        ("faq.md", "../Makefile", f"{REPOSITORY}/blob/main/Makefile"),
        ("faq.md", "https://arxiv.org/abs/1", "https://arxiv.org/abs/1"),
    ],
)
def test_a_link_leads_to_its_place_on_the_site(page, link, expected):
    assert hooks.linked("[text]", link, page, REPOSITORY) == f"[text]({expected})"
    if expected.startswith(REPOSITORY):
        assert hooks.linked("[text]", link, page, "") == "text", "a link to no page, without a repository"


def test_links_in_code_stay():
    page = type("Page", (), {"file": type("File", (), {"src_uri": "faq.md"})})
    config = type("Config", (), {"repo_url": REPOSITORY})
    text = "[a](../Makefile)\n\n```python\nx = f[0](../Makefile)\n```\n"
    rewritten = hooks.on_page_markdown(text, page=page, config=config, files=None)
    assert rewritten == text.replace("[a](../Makefile)", f"[a]({REPOSITORY}/blob/main/Makefile)")


def test_files_outside_the_pages_that_the_site_shows_exist():
    files = hooks.outside_files(DOCS)
    assert any(path.endswith(".png") for path in files)
    assert [path for path in files if not (ROOT / path).is_file()] == []


@pytest.mark.parametrize("page", REFERENCE, ids=lambda path: path.stem)
def test_the_reference_names_documented_objects(page):
    names = re.findall(r"^::: ([\w.]+)$", page.read_text(), flags=re.MULTILINE)
    assert names
    for name in names:
        assert resolve(name).__doc__, name


def resolve(path):
    """Return the module or the attribute of a module at `path`."""
    try:
        return importlib.import_module(path)
    except ModuleNotFoundError:
        module, _, name = path.rpartition(".")
        return getattr(importlib.import_module(module), name)


def test_the_reference_has_every_public_name():
    text = "".join(page.read_text() for page in REFERENCE)
    assert [name for name in earl_jax.__all__ if f"::: earl_jax.{name}\n" not in f"{text}\n"] == []
    names = (DOCS / "python_api.md").read_text().split("## Names")[1]
    assert [name for name in earl_jax.__all__ if name != "InputError" and f"`{name}`" not in names] == []


@pytest.mark.parametrize("path", WORKFLOWS, ids=lambda path: path.stem)
def test_a_workflow_is_valid_and_pins_its_actions(path):
    workflow = yaml.safe_load(path.read_text())
    assert workflow["permissions"] == {"contents": "read"}
    assert workflow[True]  # YAML reads the key "on" as a boolean
    for job in workflow["jobs"].values():
        assert job["runs-on"] == "ubuntu-24.04"
        assert set(job.get("needs", "").split()) <= set(workflow["jobs"])
    for step in (step for job in workflow["jobs"].values() for step in job["steps"]):
        assert ("uses" in step) != ("run" in step)
        assert re.fullmatch(r"[\w./-]+@[0-9a-f]{40}", step.get("uses", f"a@{'0' * 40}"))
    pins = re.findall(r"uses: (\S+)( # v[\d.]+)?", path.read_text())
    assert pins
    assert all(version for _, version in pins)
