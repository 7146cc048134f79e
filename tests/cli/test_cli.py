"""The command line: output, exit codes, one-line errors."""

import json
import re
import shutil
import signal
import subprocess
import sys
import warnings
from unittest.mock import Mock

import numpy as np
import pytest

from earl_jax import InputError, __version__, cli
from earl_jax.runs.checkpoint import newest
from earl_jax.runs.provenance import made_by
from earl_jax.training import load_transitions
from tests.cli.process import ENVIRONMENT, TASK, one_line, run, start, succeed, training, wait_until

TRAIN = ["train", TASK]
SWEEP = ["sweep", "nowhere.toml"]


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """The folder of a finished run."""
    folder = tmp_path_factory.mktemp("runs") / "whole"
    printed = json.loads(succeed(*training(folder), "--json"))
    assert set(printed["score"]) == {"metric", "mean", "low", "high", "scores", "evaluations", "first", "last"}
    return folder


def test_a_run_is_shown_without_checkpoints(finished, tmp_path):
    folder = shutil.copytree(finished, tmp_path / "größe \\", ignore=shutil.ignore_patterns("checkpoints"))
    out = succeed("show", folder)
    shown = [" ".join(line.split()) for line in out.splitlines()]
    method = "method: fbrl (batch_size=16, random_steps=20, hidden_sizes=[16])"
    assert {method, "seeds: 0, 1", "policies: of step 120", f"in Python: earl_jax.load({str(folder)!r})"} <= set(shown)
    assert f"folder: {folder}" in shown
    printed = json.loads(succeed("show", folder, "--json"))
    assert (printed["step"], printed["finished"], printed["policies"]) == (120, True, 120)
    assert printed["score"]["metric"] == "deployed/success"
    mean = np.mean(printed["metrics"]["critic_loss"])
    assert f"critic_loss {mean:.6g}" in shown
    assert f"made by: earl-jax {made_by(printed['provenance'])}" in shown


def test_json_has_the_warnings_that_are_printed(finished, tmp_path, monkeypatch):
    def show(message, category, *location):  # to stderr, as Python does and pytest does not
        sys.stderr.write(warnings.formatwarning(message, category, *location[:2]))

    monkeypatch.setattr(warnings, "showwarning", show)
    assert "warnings" not in json.loads(succeed("table", finished, "--json"))
    shutil.copytree(finished, tmp_path / "a")
    shutil.copytree(finished, tmp_path / "b")
    code, out, err = run("table", tmp_path, "--json")
    [warning] = json.loads(out)["warnings"]
    assert re.search(r"left out: .*b has the same numbers of seed 0 as .*a; a seed counts once", warning)
    assert (code, err) == (0, f"earl-jax: {warning}\n")


def test_seeds_with_values_of_their_own_have_a_score_each(tmp_path):
    lines = succeed(*training(tmp_path / "run", "--set", "learning_rate=[1e-3,3e-4]")).splitlines()
    labels = [f"fbrl (learning_rate={value})" for value in ("0.001", "3e-4")]
    starts = [f"{tmp_path / 'run'}: {label}: deployed/success " for label in labels]
    assert [line[: len(start)] for line, start in zip(lines, starts, strict=True)] == starts
    assert all("mean of 1 seed over" in line for line in lines)
    shown = succeed("show", tmp_path / "run")
    scores = ("\n" + 11 * " ").join(line.partition(": ")[2].partition(";")[0] for line in lines)
    assert f"score:     {scores}\n" in shown
    columns = r"a column for each of fbrl \(learning_rate=0.001\); fbrl \(learning_rate=3e-4\)\n  \S+ +\S+  \S+\n"
    assert re.search(columns, shown)
    scored = json.loads(succeed("show", tmp_path / "run", "--json"))
    own = [score["scores"][0] for score in scored["part_scores"].values()]
    assert (list(scored["part_scores"]), own) == (labels, scored["score"]["scores"])
    evaluated = succeed("evaluate", tmp_path / "run", "--episodes", "2")
    means = re.findall(r"^fbrl \(.*\): deployed/success \d\.\d{3}, per seed \d\.\d{3}$", evaluated, re.MULTILINE)
    assert len(means) == 2
    assert evaluated.count("\nthe run: fbrl (learning_rate=") == 2


def test_killed_run_resumes_bit_identically(finished, tmp_path):
    folder = tmp_path / "killed"
    process = start(*training(folder))
    assert wait_until(lambda: list(folder.glob("checkpoints/0*")))
    process.send_signal(signal.SIGKILL)
    process.communicate()
    assert process.returncode == -signal.SIGKILL
    assert (folder / "metrics.csv").read_text() != (finished / "metrics.csv").read_text()
    succeed("resume", folder)
    for name in ("metrics.csv", "policies.npz"):
        assert (folder / name).read_bytes() == (finished / name).read_bytes()
    assert [newest(path / "checkpoints") for path in (folder, finished)] == [120, 120]
    evaluations = [succeed("evaluate", path, "--episodes", "2", "--json") for path in (folder, finished)]
    assert evaluations[0] == evaluations[1]
    assert len(json.loads(evaluations[0])["deployed/success"]) == 2


def test_export_writes_the_life_of_a_seed_as_a_minari_dataset(finished, tmp_path, monkeypatch):
    minari = pytest.importorskip("minari", reason="datasets need the extra 'minari'")
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    out = succeed("export", finished, "--seed", "1")
    assert out.startswith(f"earl_jax/{TASK}/fbrl-seed-1-v0: ")
    loaded = list(minari.load_dataset(f"earl_jax/{TASK}/fbrl-seed-1-v0"))
    _, steps, terminal = load_transitions(finished, 1)
    assert len(steps.ends) == 120
    assert [len(episode) for episode in loaded] == np.diff(np.flatnonzero(steps.ends), prepend=-1).tolist()
    expected = {"actions": steps.actions, "rewards": steps.rewards, "terminations": terminal}
    for name, values in expected.items():
        np.testing.assert_array_equal(np.concatenate([getattr(episode, name) for episode in loaded]), values)
    for part, states in ((slice(-1), steps.states), (slice(1, None), steps.next_states)):
        obs = np.concatenate([episode.observations[part] for episode in loaded])
        np.testing.assert_array_equal(obs, np.concatenate([states, steps.goals], axis=1))
    one_line(run("export", finished, "--seed", "5"), f"no seed 5 in {finished}; choose from 0, 1")
    one_line(run("export", finished, "--direction", "forward"), "leave out --direction")
    one_line(run("export", TASK, "--seed", "1"), "leave out --seed")


@pytest.mark.parametrize(
    ("arguments", "messages"),
    [
        (["train"], ["earl-jax: train needs a task"]),
        ([*TRAIN, "--set", "gamma"], ["name=value"]),
        ([*TRAIN, "--learner", "td3", "--set", "learner=sac"], ["learner is given twice"]),
        (["train", "sawyer_door", "--engine", "c", "--set", "engine=mjx"], ["engine is given twice"]),
        ([*TRAIN, "--set", "eval_every=30"], ["beside the options: eval_every=30, or --eval-every 30"]),
        ([*TRAIN, "--learning-rate=1e-3"], ["--learning-rate is an option", "--set learning_rate=VALUE"]),
        ([*TRAIN, "--reward-type", "dense"], ["--set reward_type=VALUE"]),
        (["resume", "nowhere"], ["/nowhere is not a run folder", "config.json"]),
        ([*SWEEP, "--launcher", "cloud"], ["cloud", "local", "slurm"]),
        ([*SWEEP, "--launcher", "slurm", "--slurm", "time", "--slurm", "mem=4G"], ["name=value"]),
        (["compare", ".", "--out", "a.png", "b.docx"], ["b.docx: comparisons are written as .md,"]),
        (["table", ".", "--out", "a.png"], ["a.png: tables are written as .md,"]),
    ],
)
def test_invalid_input_exits_with_code_2_and_the_choices(arguments, messages, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    code, out, err = run(*arguments)
    assert code == 2
    assert [message for message in messages if message not in err + out] == []
    assert "Traceback" not in err
    assert not any(tmp_path.iterdir())


def test_a_traceback_of_invalid_input_can_be_requested():
    with pytest.raises(InputError, match="unknown task 'nowhere'"):
        cli.main(["train", "nowhere", "--traceback"])


BEFORE_MAIN = """
import sys
class Finder:
    def find_spec(name, *where):
        if name == "tyro":
            raise KeyboardInterrupt
sys.meta_path.insert(0, Finder)
import earl_jax.cli
"""


def test_an_interrupt_while_the_package_or_numpy_is_loaded_is_one_line(monkeypatch):
    process = subprocess.run([sys.executable, "-c", BEFORE_MAIN], env=ENVIRONMENT, capture_output=True, text=True)
    assert (process.returncode, process.stderr) == (130, "earl-jax: interrupted\n")
    monkeypatch.setattr(sys, "last_value", KeyboardInterrupt(), raising=False)  # as after numpy printed it
    monkeypatch.setattr(sys.modules["earl_jax.cli.main"], "_run", Mock(side_effect=ImportError("numpy")))
    assert run("list") == (130, "", "earl-jax: interrupted\n")


def test_version():
    assert run("--version") == (0, f"earl-jax {__version__}\n", "")


def test_an_error_of_the_system_is_named_without_its_number(tmp_path):
    code, _, err = run("import-demos", tmp_path / "nope.pkl")
    assert (code, err) == (2, f"earl-jax: {tmp_path / 'nope.pkl'}: No such file or directory\n")
