"""`--import`: a task, a method and a learner of a file in every command, and runs of them that are read without it."""

import json
import shutil
import sys

import pytest

from earl_jax import cli, envs
from earl_jax.runs.files import RunWarning
from tests.cli.process import one_line, run, succeed, training
from tests.conftest import MINE, own_registries, write_mine
from tests.report.run_files import change_config

READERS = {"table": ["--json"], "best": ["--json"], "plot": ["--out", "x.png"], "report": ["--out", "x.html"]}


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    """A folder with mine.py and a run of its classes."""
    folder = tmp_path_factory.mktemp("own")
    mine = write_mine(folder)
    with own_registries():
        succeed(*training(folder / "run", "--learner", "slow", task="meadow", algo="patient"), "--import", mine)
    return folder


@pytest.fixture
def own(trained, tmp_path, monkeypatch, registries):
    """A copy of `trained`, as the working directory."""
    monkeypatch.chdir(shutil.copytree(trained, tmp_path / "own"))
    return tmp_path / "own"


def test_a_run_is_read_without_its_classes(own):
    outputs = {command: run(command, "run", *options) for command, options in READERS.items()}
    assert {command: (code, err) for command, (code, _, err) in outputs.items()} == dict.fromkeys(READERS, (0, ""))
    [row] = json.loads(outputs["table"][1])["rows"]
    assert (row["env"], row["algo"], row["seeds"]) == ("meadow", "patient", 2)
    assert json.loads(outputs["best"][1])["rows"][0]["metric"] == "deployed/success"
    assert "No maps of meadow: unknown task" in (own / "x.html").read_text()


@pytest.mark.parametrize("command", [["resume"], ["evaluate"], ["render", "--acting", "policy"]])
def test_a_command_that_needs_the_classes_names_the_file_and_never_runs_it(own, command):
    change_config(own / "run", imports=[{"file": "my file.py", "sha256": "0" * 64}])
    (own / "my file.py").write_text("raise SystemExit('ran')")
    message = "this run was trained with my file.py (sha256 00000000): pass --import 'my file.py'"
    assert run(command[0], "run", *command[1:]) == (2, "", f"earl-jax: unknown task 'meadow': {message}\n")


def test_commands_know_the_classes_of_the_file(own):
    succeed("evaluate", "run", "--episodes", "2", "--import", "mine.py")
    assert succeed("list", "meadow", "--import=mine.py").splitlines()[0] == "meadow (task)"
    code, _, err = run("resume", "run", "--import", "mine.py")
    assert code == 0, err
    assert "changed" not in err
    assert sys.path.index(str(own)) == len(sys.path) - 1, "modules beside the file hide no others"


def test_a_file_that_has_changed_since_training_is_named_and_recorded(own):
    (own / "mine.py").write_text(f"{MINE}# edited\n")
    [then] = json.loads((own / "run/config.json").read_text())["imports"]
    shutil.rmtree(own / "run/checkpoints/000000120")
    message = f"^mine.py has changed since run was trained .sha256 {then['sha256'][:8]} then, "
    for command in (["train", "--out", "run", "--config"], ["resume"]):  # train refuses the folder
        with pytest.warns(RunWarning, match=message):
            assert run(*command, "run", "--import", "mine.py")[0] == (2 if "train" in command else 0)
    now = json.loads((own / "run/config.json").read_text())["imports"]
    assert (now[0], [record["file"] for record in now[1:]]) == (then, ["mine.py"])


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("nowhere.py", None, "nowhere.py can't be imported: there is no such file"),
        ("mine.toml", "", "mine.toml can't be imported: its name does not end in .py"),
        ("nothing.py", "x = 1", "nothing.py can't be imported: it registers nothing; call earl_jax.register_algo"),
        ("taken.py", MINE.replace("patient", "naive"), "taken.py can't be imported: method 'naive' already exists"),
        ("json.py", "", "json.py has the name of another module"),
    ],
)
def test_a_file_that_cannot_be_imported_is_an_error_of_one_line(own, name, text, message):
    if text is not None:
        (own / name).write_text(text)
    one_line(run("list", "--import", name), message)


def test_an_error_in_a_file_keeps_its_traceback(own):
    (own / "broken.py").write_text("import earl_jax\n1 / 0\n")
    with pytest.raises(ZeroDivisionError) as raised:
        cli.main(["list", "--import", "broken.py"])
    assert raised.traceback[-1].path == own / "broken.py"
    assert raised.value.__notes__ == [f"earl-jax: {own / 'broken.py'} can't be imported"]
    assert "meadow" not in envs.list_envs()
