"""The commit that a run records, which says whether files differ from it."""

import json
import re
import subprocess

import pytest

from earl_jax.runs.provenance import (
    changed_versions,
    checkout_commit,
    installed_release,
    made_by,
    provenance,
    short_commit,
)
from tests.conftest import write_files


def git(root, *command):
    author = ["-c", "user.name=a", "-c", "user.email=a@b.c", "-c", "commit.gpgsign=false"]
    process = subprocess.run(["git", "-C", str(root), *author, *command], capture_output=True, text=True, check=True)
    return process.stdout.strip()


@pytest.fixture
def package(tmp_path):
    """A package in a checkout that ignores cached bytecode, with assets and a README beside it."""
    for folder in ("package", "assets"):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "file").write_text("1\n")
    (tmp_path / "README").write_text("1\n")
    (tmp_path / ".gitignore").write_text("*.pyc\n")
    git(tmp_path, "init", "-q")
    git(tmp_path, "add", ".")
    git(tmp_path, "commit", "-qm", "first")
    return tmp_path / "package"


def test_packages_with_other_versions_than_recorded_are_named():
    recorded = provenance()
    assert changed_versions(recorded) == ""
    here = recorded["versions"]["jax"]
    old = recorded | {"versions": recorded["versions"] | {"jax": "0.4.1", "numpy": "1.0"}}
    assert changed_versions(old) == f"jax 0.4.1 (here {here})"
    newer = changed_versions(recorded | {"commit": 40 * "a" + "-dirty"})
    assert re.fullmatch(r"earl-jax a{9}-dirty \(here [0-9a-f]{9}(-dirty)?\)", newer)
    assert changed_versions(None) == changed_versions({"versions": []}) == changed_versions({"versions": {}}) == ""


def test_changes_outside_package_and_assets_do_not_mark_a_commit(package):
    first = git(package, "rev-parse", "HEAD")
    (package / "cached.pyc").write_text("1\n")
    (package.parent / "README").write_text("2\n")
    assert checkout_commit(package) == first
    git(package.parent, "commit", "-qam", "README")
    assert checkout_commit(package) == first != git(package, "rev-parse", "HEAD")


@pytest.mark.parametrize("file", ["package/file", "package/new", "assets/file", "removed"])
def test_a_commit_ends_in_a_mark_until_changes_are_committed(package, file):
    (package / "file").unlink() if file == "removed" else (package.parent / file).write_text("2\n")
    assert checkout_commit(package) == f"{git(package, 'rev-parse', 'HEAD')}-dirty"
    git(package.parent, "add", ".")
    assert checkout_commit(package) == f"{git(package, 'rev-parse', 'HEAD')}-dirty"
    git(package.parent, "commit", "-qm", "second")
    assert checkout_commit(package) == git(package, "rev-parse", "HEAD")


def test_files_that_git_does_not_track_have_no_commit(package):
    installed = package.parent / "installed" / "package"
    installed.mkdir(parents=True)
    (installed / "file").write_text("1\n")
    assert checkout_commit(installed) is None
    assert checkout_commit(package.parent / "nowhere") is None


def test_an_installed_wheel_has_its_release_and_the_commit_of_its_url(tmp_path, monkeypatch):
    package = tmp_path / "earl_jax"
    files = {
        "earl_jax/__init__.py": "x = 1\n",
        "earl_jax-0.2.dist-info/METADATA": "Metadata-Version: 2.1\nName: earl-jax\nVersion: 0.2\n",
        "earl_jax-0.2.dist-info/RECORD": "earl_jax/__init__.py,sha256=nia_NpkRxFwkPGhBR7I_yeHc_PJX0pmhxjIBam_NM_Q,6\n",
    }
    write_files(files, tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    assert installed_release(package) == ("0.2", None)
    assert installed_release(tmp_path / "elsewhere") == (None, None)
    source = {"url": "https://example.org/earl_jax", "vcs_info": {"vcs": "git", "commit_id": "0123456789"}}
    (tmp_path / "earl_jax-0.2.dist-info/direct_url.json").write_text(json.dumps(source))
    (package / "__init__.py").write_text("x = 2\n")
    assert installed_release(package) == ("0.2-dirty", "0123456789-dirty")
    (package / "__init__.py").unlink()
    assert made_by({"commit": None, "release": installed_release(package)[0]}) == "0.2-dirty"


def test_a_short_commit_keeps_its_mark():
    assert [short_commit("0123456789" + end) for end in ("", "-dirty")] == ["012345678", "012345678-dirty"]
    assert short_commit(short_commit("0123456789-dirty")) == "012345678-dirty"
    assert short_commit("") == ""
