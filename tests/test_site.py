"""The site of the documentation: links and names, without building it, which finds broken ones; and the workflows."""

import re

import pytest
import yaml

import earl_jax
from docs.site import hooks
from tests.test_docs import DOCS, ROOT

REPOSITORY = "https://example.org/owner/earl_jax"
REFERENCE = sorted((DOCS / "reference").glob("*.md"))
WORKFLOWS = sorted((ROOT / ".github" / "workflows").glob("*.yml"))


@pytest.mark.parametrize(
    ("page", "link", "expected"),
    [
        ("training.md", "results.md#seeds", "results.md#seeds"),
        ("training.md", "../CHANGELOG.md", "changelog.md"),
        ("changelog.md", "docs/results.md", "results.md"),
        ("training.md", "../examples/cfbrl/README.md#options", "cfbrl.md#options"),
        ("cfbrl.md", "../../docs/formalism.md", "formalism.md"),
        ("cfbrl.md", "../../benchmarks/results/cfbrl/curves.png", "benchmarks/results/cfbrl/curves.png"),
        ("README.md", "../notebooks", "notebooks/index.md"),
        ("training.md", "../notebooks/02_compare_two_methods.py", "notebooks/02_compare_two_methods.md"),
        ("notebooks/01_x.md", "01_x_1.png", "01_x_1.png"),
        ("notebooks/01_x.md", "../docs/fidelity.md#pure-mjx", "../fidelity.md#pure-mjx"),
        ("reference/index.md", "../training.md", "../training.md"),
        ("training.md", "../Makefile", f"{REPOSITORY}/blob/main/Makefile"),
        ("training.md", "https://arxiv.org/abs/1", "https://arxiv.org/abs/1"),
    ],
)
def test_a_link_leads_to_its_place_on_the_site(page, link, expected):
    assert hooks.linked("[text]", link, page, REPOSITORY) == f"[text]({expected})"
    if expected.startswith(REPOSITORY):
        assert hooks.linked("[text]", link, page, "") == "text", "a link to no page, without a repository"


def test_links_in_code_stay():
    page = type("Page", (), {"file": type("File", (), {"src_uri": "training.md"})})
    config = type("Config", (), {"repo_url": REPOSITORY})
    text = "[a](../Makefile)\n\n```python\nx = f[0](../Makefile)\n```\n"
    rewritten = hooks.on_page_markdown(text, page=page, config=config, files=None)
    assert rewritten == text.replace("[a](../Makefile)", f"[a]({REPOSITORY}/blob/main/Makefile)")


def test_files_outside_the_pages_that_the_site_shows_exist():
    files = hooks.outside_files(DOCS)
    assert any(path.endswith(".png") for path in files)
    assert [path for path in files if not (ROOT / path).is_file()] == []


def test_the_reference_has_the_public_names_of_the_package():
    text = "\n".join(page.read_text() for page in REFERENCE)
    assert sorted(re.findall(r"^::: earl_jax\.(\w+)$", text, flags=re.MULTILINE)) == sorted(earl_jax.__all__)


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
