"""Tests of the command line: output, exit codes, one-line errors."""

import json
import shutil
import signal
import sys
import time
import warnings

import pytest

from earl_jax import cli
from tests.cli.process import run, snapshot, start, train


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """The folder of a finished run, and the JSON that the command printed."""
    folder = tmp_path_factory.mktemp("runs") / "whole"
    code, out, err = run(*train(folder), "--json")
    assert code == 0, err
    return folder, json.loads(out)


def truncate_largest_file(checkpoint):
    largest = max(checkpoint.rglob("*"), key=lambda path: path.stat().st_size if path.is_file() else 0)
    largest.write_bytes(largest.read_bytes()[:-7])


def test_run_folder_contains_config_and_metrics(finished):
    folder, printed = finished
    config = json.loads((folder / "config.json").read_text())
    assert config["algo"] == "fbrl"
    assert config["options"] == {"batch_size": 16, "hidden_sizes": [16, 16], "random_steps": 20}
    assert config["engine"] == "kinematic"
    assert config["provenance"]["versions"]["jax"]
    lines = (folder / "metrics.csv").read_text().splitlines()
    assert len(lines) == 1 + 2 * 10
    assert lines[0].startswith("step,seed,")
    assert printed["steps"] == 400
    assert set(printed["deployed/success"]) >= {"mean", "stderr", "iqm", "low", "high"}


def test_killed_run_resumes_bit_identically(finished, tmp_path):
    whole, _ = finished
    folder = tmp_path / "killed"
    process = start(*train(folder))
    deadline = time.monotonic() + 240
    while not list(folder.glob("checkpoints/0*")) and time.monotonic() < deadline:
        time.sleep(0.02)
    process.send_signal(signal.SIGKILL)
    process.communicate()
    assert process.returncode == -signal.SIGKILL
    assert (folder / "metrics.csv").read_text() != (whole / "metrics.csv").read_text()
    code, _, err = run("resume", folder)
    assert code == 0, err
    assert (folder / "metrics.csv").read_bytes() == (whole / "metrics.csv").read_bytes()
    manifests = [json.loads((path / "checkpoints/000000400/manifest.json").read_text()) for path in (folder, whole)]
    assert manifests[0]["step"] == manifests[1]["step"] == 400
    evaluations = [run("evaluate", path, "--episodes", "5", "--json")[1] for path in (folder, whole)]
    assert evaluations[0] == evaluations[1]


def test_evaluate_plot_and_table_read_a_run_folder(finished, tmp_path):
    folder, _ = finished
    code, out, _ = run("evaluate", folder, "--episodes", "3", "--json")
    assert code == 0
    assert len(json.loads(out)["deployed/success"]) == 2
    code, out, err = run("plot", folder, "--out", tmp_path / "curves.png")
    assert code == 0, err
    assert (tmp_path / "curves.png").read_bytes().startswith(b"\x89PNG")
    code, out, _ = run("table", folder, "--json", "--out", tmp_path / "table.md")
    assert code == 0
    row = json.loads(out)["rows"][0]
    assert row["published_deployed"] == "0.94 (0.04)"
    assert row["options"] == "batch_size=16, hidden_sizes=[16, 16], random_steps=20"
    assert row["steps"] == 400
    assert "| fbrl | 2 | 400 |" in (tmp_path / "table.md").read_text()


def test_train_refuses_the_folder_of_another_run(finished):
    folder, _ = finished
    before = snapshot(folder)
    code, _, err = run(*train(folder, algo="naive"))
    assert code == 2
    assert "holds another run" in err
    assert "earl-jax resume" in err
    assert snapshot(folder) == before


def test_damaged_checkpoints_end_with_a_one_line_error_and_stay_unchanged(finished, tmp_path):
    folder = shutil.copytree(finished[0], tmp_path / "damaged")
    for path in (folder / "checkpoints").iterdir():
        truncate_largest_file(path)
    (folder / "policies.npz").unlink()
    before = snapshot(folder)
    for command in (["resume", folder], ["evaluate", folder]):
        code, _, err = run(*command)
        assert code == 2
        assert len(err.strip().splitlines()) == 1
        assert "is damaged" in err
        assert snapshot(folder) == before


def show_warning(message, category, *location):
    """Write a warning to stderr, as Python does and pytest does not."""
    sys.stderr.write(warnings.formatwarning(message, category, *location[:2]))


def test_resume_uses_the_previous_checkpoint_if_the_newest_is_damaged(finished, tmp_path, monkeypatch):
    folder = shutil.copytree(finished[0], tmp_path / "damaged")
    truncate_largest_file(folder / "checkpoints/000000400")
    monkeypatch.setattr(warnings, "showwarning", show_warning)
    code, _, err = run("resume", folder)
    assert code == 0, err
    assert err.splitlines()[0].startswith("earl-jax: checkpoint")
    assert "000000400 is damaged" in err
    assert "continuing from 000000360" in err
    assert (folder / "metrics.csv").read_bytes() == (finished[0] / "metrics.csv").read_bytes()


@pytest.mark.parametrize(
    ("arguments", "messages"),
    [
        (["train", "cheetah"], ["unknown env 'cheetah'", "tabletop_organization"]),
        (["train", "tabletop_organization", "--algo", "ppo"], ["unknown algo 'ppo'", "naive", "vaprl"]),
        (["train", "tabletop_organization", "--set", "gamma=1"], ["no option 'gamma'", "discount"]),
        (["train", "tabletop_organization", "--set", "gamma"], ["name=value"]),
        (["train", "tabletop_organization", "--set", "name=x"], ["no option 'name'"]),
        (["train", "tabletop_organization", "--set", "env=x"], ["no option 'env'"]),
        (["train", "tabletop_organization", "--devices", "0"], ["0 devices requested"]),
        (["train", "tabletop_organization", "--seeds", "1000000000"], ["at most 65536 seeds"]),
        (["train", "tabletop_organization", "--set", f"discount={409 * '9'}"], ["discount must be a finite number"]),
        (
            ["train", "tabletop_organization", "--eval-episodes", "100000000000"],
            ["eval_episodes must lie in [1, 100000]"],
        ),
        (["train", "tabletop_organization", "--steps", "55", "--eval-every", "10"], ["not a multiple of eval_every"]),
        (["resume", "nowhere"], ["not a run folder", "config.json"]),
        (["evaluate", "nowhere"], ["not a run folder"]),
        (["plot", "nowhere"], ["not a run folder"]),
        (["table", "nowhere", "--last", "0"], ["last must be at least 1"]),
        (["sweep", "nowhere.toml"], ["nowhere.toml can't be read"]),
        (["sweep", "nowhere.toml", "--launcher", "cloud"], ["cloud", "local", "slurm"]),
        (["sweep", "nowhere.toml", "--slurm", "time=5"], ["--slurm options go with --launcher slurm"]),
        (["sweep", "nowhere.toml", "--launcher", "slurm", "--slurm", "time"], ["name=value"]),
        (["sweep", "nowhere.toml", "--max-lanes", "0"], ["max_lanes must be at least 1"]),
        (["fly"], ["fly"]),
    ],
)
def test_invalid_input_exits_with_code_2_and_the_choices(arguments, messages, tmp_path, capsys):
    if arguments[0] == "train":
        arguments = [*arguments, "--out", str(tmp_path / "run")]
    with pytest.raises(SystemExit) as exit_info:
        cli.main(arguments)
    assert exit_info.value.code == 2
    assert not (tmp_path / "run").exists()
    output = capsys.readouterr()
    for message in messages:
        assert message in output.err + output.out
    assert "Traceback" not in output.err
