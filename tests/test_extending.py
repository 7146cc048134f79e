"""The example of docs/extending.md lives as it stands there, and packages that are wrong are told of in one line."""

import dataclasses
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from earl_jax import algos, envs
from earl_jax.registry import Registry
from tests.conftest import CACHE

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs" / "extending.md").read_text()
FILES = dict(re.findall(r"\*\*`(\S+)`\*\*\n\n```\w+\n(.*?)```", PAGE, flags=re.DOTALL))
SNIPPETS = [code for code in re.findall(r"```python\n(.*?)```", PAGE, flags=re.DOTALL) if code not in FILES.values()]
TINY = ["hidden_sizes=[16,16]", "batch_size=16", "random_steps=20"]

USE = """
import sys
from pathlib import Path
import pytest
from earl_jax.cli import main

main(["list", "--json"])
tiny = ["--seeds", "2", "--steps", "40", "--eval-every", "40", "--eval-episodes", "2", "--checkpoint-every", "40"]
main(["train", "pasture", "--algo", "detour", *tiny, "--out", "run", "--set", "home_share=0.8", "fear=0.4", *OPTIONS])
main(["evaluate", "run", "--episodes", "2"])
main(["resume", "run", "--steps", "80"])
exec(DEMOS)
demos = f"demo_file={Path('pasture.npz').resolve()}"
main(["train", "pasture", "--algo", "vaprl", *tiny, "--out", "vaprl", "--set", demos, *OPTIONS])
raise SystemExit(pytest.main([CONTRACT, "-k", "pasture", "-q", "-p", "no:cacheprovider", "-p", "no:xdist"]))
"""


def write(files, folder):
    for name, text in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)


def test_the_page_shows_a_whole_package():
    assert list(FILES) == [
        "pyproject.toml", "src/earl_pasture/__init__.py", "src/earl_pasture/pasture.py", "src/earl_pasture/detour.py",
    ]  # fmt: skip


@pytest.mark.slow
def test_the_package_is_installed_listed_trained_evaluated_and_resumed(tmp_path):
    write(FILES, tmp_path / "package")
    pip = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-build-isolation", "--no-index"]
    subprocess.run([*pip, "--target", str(tmp_path / "site"), str(tmp_path / "package")], check=True)
    given = {"OPTIONS": TINY, "DEMOS": SNIPPETS[1], "CONTRACT": str(ROOT / "tests" / "envs" / "test_contract.py")}
    code = "".join(f"{name} = {value!r}\n" for name, value in given.items()) + USE
    environment = {**os.environ, "PYTHONPATH": str(tmp_path / "site"), "JAX_COMPILATION_CACHE_DIR": str(CACHE)}
    found = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=570
    )
    assert found.returncode == 0, found.stdout + found.stderr
    listed = found.stdout.splitlines()[0]
    assert '"pasture"' in listed
    assert '"detour"' in listed
    assert re.search(r"\d+ passed", found.stdout)
    config = (tmp_path / "run" / "config.json").read_text()
    assert '"home_share": 0.8' in config
    assert '"fear": 0.4' in config
    assert len((tmp_path / "run" / "metrics.csv").read_text().splitlines()) == 1 + 2 * 2


@pytest.mark.slow
def test_the_notebooks_way_trains(tmp_path, monkeypatch):
    write(FILES, tmp_path)
    monkeypatch.syspath_prepend(tmp_path / "src")
    for registry in (algos._ALGOS, envs._ENVS):
        monkeypatch.setattr(registry, "_table", dict(registry._table))
    names = {}
    exec(SNIPPETS[0], names)
    assert names["result"].method.home_share.tolist() == pytest.approx([0.2, 0.8])
    assert names["result"].metrics["deployed/success"].shape == (2, 2)


@pytest.fixture
def distribution(tmp_path, monkeypatch):
    """Puts a package on the path: its entry points for envs, and the source of its module `theirs`."""

    def put(points, source="", name="Their_Package"):
        lines = "".join(f"{key} = {value}\n" for key, value in points.items())
        write(
            {
                f"{name}-0.1.0.dist-info/METADATA": f"Metadata-Version: 2.1\nName: {name}\nVersion: 0.1.0\n",
                f"{name}-0.1.0.dist-info/entry_points.txt": f"[earl_jax.envs]\n{lines}",
                "theirs.py": source,
            },
            tmp_path / name,
        )
        monkeypatch.delitem(sys.modules, "theirs", raising=False)
        monkeypatch.syspath_prepend(tmp_path / name)
        return Registry("env", {"sawyer_door": "earl_jax.envs.sawyer.door:SawyerDoor"})

    return put


GOOD = """
import dataclasses
from earl_jax.envs.tabletop import TabletopOrganization

class Meadow(TabletopOrganization):
    name = "meadow"
"""


def test_a_package_brings_its_names(distribution):
    registry = distribution({"meadow": "theirs:Meadow"}, GOOD)
    assert registry.names() == ["meadow", "sawyer_door"]
    assert registry.build("meadow", {"wide": True}).wide
    with pytest.raises(ValueError, match="'meadow' exists already"):
        registry.register("meadow", type(registry.build("meadow", {})))


@pytest.mark.parametrize(
    ("target", "source", "told"),
    [
        ("theirs:Meadow", "import shepherds", "Their_Package 0.1.0 cannot be loaded: ModuleNotFoundError: No module named 'shep"),
        ("theirs:Meadow", "1 / 0", "cannot be loaded: ZeroDivisionError"),
        ("theirs:Meadow", "", "cannot be loaded: AttributeError.*Meadow"),
        ("theirs:Meadow", GOOD.replace('"meadow"', '"lawn"'), "theirs:Meadow of Their_Package 0.1.0 has the name 'lawn'"),
        ("theirs:Meadow", "def Meadow(): ...", "must be a dataclass, not <function Meadow"),
    ],
    ids=["no import", "an error", "no class", "another name", "no dataclass"],
)  # fmt: skip
def test_a_broken_package_is_listed_and_told_of_where_it_is_used(distribution, target, source, told):
    registry = distribution({"meadow": target}, source)
    assert registry.names() == ["meadow", "sawyer_door"]
    assert registry.get("sawyer_door").name == "sawyer_door"
    with pytest.raises(ValueError, match=f"env 'meadow'.*{told}"):
        registry.get("meadow")


def test_a_name_claimed_twice_is_nobodys(distribution):
    registry = distribution({"sawyer_door": "theirs:Meadow", "meadow": "theirs:Meadow"}, GOOD)
    assert registry.names() == ["meadow", "sawyer_door"]
    with pytest.raises(ValueError, match=r"'sawyer_door' is claimed by earl_jax and Their_Package 0\.1\.0; rename"):
        registry.get("sawyer_door")
    assert registry.get("meadow").name == "meadow"
    registry = distribution({"meadow": "theirs:Meadow"}, GOOD, name="Others")
    with pytest.raises(ValueError, match=r"'meadow' is claimed by Others 0\.1\.0 and Their_Package 0\.1\.0"):
        registry.get("meadow")


def test_what_is_registered_answers_to_its_name():
    registry = Registry("env", {})
    with pytest.raises(ValueError, match="the registered class has the name 'tabletop_organization'"):
        registry.register("table", type(envs.make("tabletop_organization")))
    assert registry.names() == []


PAGES = sorted([ROOT / "README.md", *(ROOT / "docs").glob("*.md"), *(ROOT / "notebooks").glob("*.py")])


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_lead_somewhere(page):
    for target in re.findall(r"\]\(([^)\s]+)\)", page.read_text()):
        if target.startswith("http"):
            continue
        path, _, anchor = target.partition("#")
        found = (page.parent / path) if path else page
        assert found.exists(), target
        if anchor:
            titles = re.findall(r"^#+ (.*)", found.read_text(), flags=re.MULTILINE)
            assert anchor in [re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-") for title in titles], target


def table(text, first):
    """The rows of the tables whose header begins with `first`, as lists of cells."""
    parts = re.findall(rf"^\| {re.escape(first)} \|.*\n\|[-| ]*\n((?:\|.*\n)+)", text, flags=re.MULTILINE)
    return [[cell.strip() for cell in row.strip("|").split(" | ")] for part in parts for row in part.splitlines()]


@pytest.mark.parametrize("name", ["sac", "r3l", "vaprl", "naive", "oracle", "fbrl"])
def test_the_page_of_algorithms_has_every_hyper_parameter(name):
    page = (ROOT / "docs" / "algorithms.md").read_text()
    kind = algos.SAC if name == "sac" else type(algos.make_algo(name))
    stated = {row[0].strip("`"): row[1].replace('"', "'") for row in table(page, f"field of `{kind.__name__}`")}
    fields = {field.name: repr(field.default) for field in dataclasses.fields(kind) if field.name != "sac"}
    assert stated == fields


WANTED = ["state", "action", "start", "goal", "sparse reward", "dense reward", "horizons", "demonstrations", "engine"]


def test_the_page_of_environments_has_the_numbers_of_every_task():
    page = (ROOT / "docs" / "environments.md").read_text()
    rows = {row[0].strip("`"): row[1:6] for row in table(page, "task")}
    tasks = {name: envs.make(name) for name in envs.list_envs()}
    for name, env in tasks.items():
        numbers = (env.obs_size, env.action_size, env.train_horizon, env.eval_horizon, env.goal_change)
        assert rows.pop(name) == [f"{number:,}" for number in numbers]
    assert not rows
    sections = dict(re.findall(r"^## (\S.*?)\n(.*?)(?=^## |\Z)", page, flags=re.MULTILINE | re.DOTALL))
    for name, env in tasks.items():
        shared = sections["The Sawyer arm"] if name.startswith("sawyer") else ""
        heads = " ".join(re.findall(r"^\| ([^|]*) \|", shared + sections[name], flags=re.MULTILINE))
        for wanted in WANTED:
            assert wanted in heads, (name, wanted)
        assert f"H_T {env.train_horizon:,}" in sections[name]
        assert f"H_E {env.eval_horizon:,}" in sections[name]
        assert ("none" in sections[name].split("| demonstrations |")[1].split("\n")[0]) == (not env.has_demos)


CODE = {
    name: re.findall(r"```python\n(.*?)```", (ROOT / "docs" / f"{name}.md").read_text(), flags=re.DOTALL)
    for name in ("getting_started", "formalism", "irreversible")
}


@pytest.mark.slow
@pytest.mark.parametrize("page", CODE)
def test_the_code_of_a_page_runs(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for block in CODE[page]:
        exec(compile(block, page, "exec"), {})
    assert not list(tmp_path.iterdir())
