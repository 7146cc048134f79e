"""The command line as a user meets it: its own process, exit codes, one line of cause."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time

import pytest

from earl_jax.cli.main import main
from tests.conftest import CACHE

TINY = ["--seeds", "2", "--steps", "400", "--eval-every", "40", "--eval-episodes", "2", "--checkpoint-every", "40"]
OPTIONS = ["--set", "hidden_sizes=[16,16]", "batch_size=16", "random_steps=20"]
TASKS = [
    "cheetah_run", "dhand_lightbulb", "fish_swim", "franka_kitchen", "minitaur_pen", "sawyer_door", "sawyer_peg",
    "tabletop_organization",
]  # fmt: skip
ENVIRONMENT = {
    **os.environ,
    "JAX_PLATFORMS": "cpu",
    "JAX_COMPILATION_CACHE_DIR": str(CACHE),
    "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0.2",
}


def start(*arguments):
    command = [sys.executable, "-m", "earl_jax.cli.main", *map(str, arguments)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=ENVIRONMENT)


def run(*arguments):
    process = start(*arguments)
    out, err = process.communicate(timeout=300)
    return process.returncode, out, err


def train(folder, algo="fbrl"):
    return ["train", "tabletop_organization", "--algo", algo, "--out", folder, *TINY, *OPTIONS]


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs") / "whole"
    code, out, err = run(*train(folder), "--json")
    assert code == 0, err
    return folder, json.loads(out)


def cut_short(checkpoint):
    victim = max(checkpoint.rglob("*"), key=lambda path: path.stat().st_size if path.is_file() else 0)
    victim.write_bytes(victim.read_bytes()[:-7])


def snapshot(folder):
    return {path: path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


def test_list_names_tasks_and_methods():
    code, out, _ = run("list", "--json")
    assert code == 0
    assert json.loads(out) == {"envs": TASKS, "algos": ["fbrl", "naive", "oracle", "r3l", "vaprl"]}


def test_a_run_folder_holds_what_a_repetition_needs(finished):
    folder, answer = finished
    config = json.loads((folder / "config.json").read_text())
    assert config["algo"] == "fbrl"
    assert config["options"] == {"batch_size": 16, "hidden_sizes": [16, 16], "random_steps": 20}
    assert config["engine"] == "kinematic"
    assert config["provenance"]["versions"]["jax"]
    lines = (folder / "metrics.csv").read_text().splitlines()
    assert len(lines) == 1 + 2 * 10
    assert lines[0].startswith("step,seed,")
    assert answer["steps"] == 400
    assert set(answer["deployed/success"]) >= {"mean", "stderr", "iqm", "low", "high"}


def test_a_killed_run_resumes_and_ends_bit_identical(finished, tmp_path):
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


def test_evaluate_plot_and_table(finished, tmp_path):
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


def test_training_into_another_run_leaves_it_alone(finished):
    folder, _ = finished
    before = snapshot(folder)
    code, _, err = run(*train(folder, algo="naive"))
    assert code == 2
    assert "holds another run" in err
    assert "earl-jax resume" in err
    assert snapshot(folder) == before


def test_a_damaged_checkpoint_is_one_line_and_nothing_is_overwritten(finished, tmp_path):
    folder = shutil.copytree(finished[0], tmp_path / "damaged")
    for path in (folder / "checkpoints").iterdir():
        cut_short(path)
    before = snapshot(folder)
    for command in (["resume", folder], ["evaluate", folder]):
        code, _, err = run(*command)
        assert code == 2
        assert len(err.strip().splitlines()) == 1
        assert "is damaged" in err
        assert snapshot(folder) == before


def test_where_the_newest_checkpoint_is_damaged_the_one_before_it_is_taken(finished, tmp_path):
    folder = shutil.copytree(finished[0], tmp_path / "damaged")
    cut_short(folder / "checkpoints/000000400")
    code, _, err = run("resume", folder)
    assert code == 0, err
    assert err.splitlines()[0].startswith("earl-jax: checkpoint")
    assert "000000400 is damaged" in err
    assert "going on from 000000360" in err
    assert (folder / "metrics.csv").read_bytes() == (finished[0] / "metrics.csv").read_bytes()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["train", "cheetah"], ["unknown env 'cheetah'", "tabletop_organization"]),
        (["train", "tabletop_organization", "--algo", "ppo"], ["unknown algo 'ppo'", "naive", "vaprl"]),
        (["train", "tabletop_organization", "--set", "gamma=1"], ["no option 'gamma'", "discount"]),
        (["train", "tabletop_organization", "--set", "gamma"], ["name=value"]),
        (["train", "tabletop_organization", "--steps", "55", "--eval-every", "10"], ["not a multiple of eval_every"]),
        (["resume", "nowhere"], ["no run folder", "config.json"]),
        (["evaluate", "nowhere"], ["no run folder"]),
        (["plot", "nowhere"], ["no run folder"]),
        (["table", "nowhere", "--last", "0"], ["last must be at least 1"]),
        (["sweep", "nowhere.toml"], ["nowhere.toml can't be read"]),
        (["sweep", "nowhere.toml", "--launcher", "cloud"], ["cloud", "local", "slurm"]),
        (["sweep", "nowhere.toml", "--slurm", "time=5"], ["--slurm options go with --launcher slurm"]),
        (["sweep", "nowhere.toml", "--launcher", "slurm", "--slurm", "time"], ["name=value"]),
        (["sweep", "nowhere.toml", "--max-lanes", "0"], ["max_lanes must be at least 1"]),
        (["fly"], ["fly"]),
    ],
)
def test_mistakes_end_with_two_and_name_the_choices(arguments, words, tmp_path, capsys):
    if arguments[0] == "train":
        arguments = [*arguments, "--out", str(tmp_path / "run")]
    with pytest.raises(SystemExit) as ended:
        main(arguments)
    assert ended.value.code == 2
    assert not (tmp_path / "run").exists()
    told = capsys.readouterr()
    for word in words:
        assert word in told.err + told.out
    assert "Traceback" not in told.err
