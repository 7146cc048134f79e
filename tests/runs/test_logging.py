"""Logs of a run: all of them receive the same metrics."""

import json
import sys
import time

import numpy as np
import pytest

from earl_jax import make, make_algo, train
from earl_jax.protocol import Deployment
from earl_jax.runs.config import RunConfig
from earl_jax.runs.folder import RunFolder
from earl_jax.runs.logging import LOGS, open_logs, scalars
from tests.conftest import TINY, TINY_RUN

METRICS = {40: {"deployed/success": np.array([0.0, 1.0])}, 80: {"deployed/success": np.array([0.25, 0.5])}}


def make_folder(path, *logs):
    env = make("tabletop_organization")
    lengths = {"seeds": (3, 5), "steps": 120, "eval_every": 40, "eval_episodes": 2, "checkpoint_every": 40}
    config = RunConfig.from_objects(env, make_algo("naive"), Deployment(), **lengths)
    return RunFolder.create(path, config, env.engine, logs)


def log_metrics(folder, since, *steps):
    """Send the metrics of `steps` to every log of a run that goes on from step `since`."""
    for log in open_logs(folder, [], since):
        for step in steps:
            log.log(step, METRICS[step])
        log.close()


def test_scalars_are_the_mean_and_the_value_of_each_seed():
    expected = {"deployed/success": 0.375, "deployed/success/seed_3": 0.25, "deployed/success/seed_5": 0.5}
    assert scalars((3, 5), METRICS[80]) == expected


def test_the_table_is_always_written(tmp_path):
    folder = make_folder(tmp_path / "run")
    log_metrics(folder, 0, 40, 80)
    assert [row["deployed/success"] for row in folder.rows()] == [0.0, 1.0, 0.25, 0.5]


def test_tensorboard_receives_the_metrics_and_purges_steps_after_the_checkpoint(tmp_path):
    pytest.importorskip("tensorboardX.event_file_writer", reason="needs the extra tensorboard")
    folder = make_folder(tmp_path / "run", "tensorboard")
    log_metrics(folder, 0, 40, 80)
    log_metrics(folder, 40, 80)
    values, purged = [], []
    for path in sorted((folder.path / "tensorboard").iterdir(), key=lambda path: path.stat().st_mtime_ns):
        for event in read_events(path):
            purged += [event.step] if event.HasField("session_log") else []
            values += [(value.tag, event.step, value.simple_value) for value in event.summary.value]
    means = [(step, value) for tag, step, value in values if tag == "deployed/success"]
    assert means == [(40, 0.5), (80, 0.375), (80, 0.375)]
    assert ("deployed/success/seed_3", 80, 0.25) in values
    assert purged == [41]


def read_events(path):
    """Yield the events of a file: records of a length (8 bytes), its checksum (4), the event, its checksum (4)."""
    from tensorboardX.proto import event_pb2

    data = path.read_bytes()
    while data:
        length = int.from_bytes(data[:8], "little")
        yield event_pb2.Event.FromString(data[12 : 12 + length])
        data = data[16 + length :]


@pytest.mark.slow
def test_offline_wandb_receives_the_metrics_and_a_resumed_run_keeps_its_id(tmp_path, monkeypatch):
    pytest.importorskip("wandb", reason="needs the extra wandb")
    monkeypatch.setenv("WANDB_MODE", "offline")
    folder = make_folder(tmp_path / "run", "wandb")
    log_metrics(folder, 0, 40)
    log_metrics(RunFolder.open(folder.path), 40, 80)
    files = sorted((folder.path / "wandb").glob(f"offline-run-*/run-{folder.id}.wandb"))
    assert len(files) == 2
    deadline = time.monotonic() + 20
    while len(rows := [row for file in files for row in read_history(file)]) < 2 and time.monotonic() < deadline:
        time.sleep(0.1)  # a process of its own writes the files
    assert [(row["_step"], row["deployed/success"]) for row in rows] == [(40, 0.5), (80, 0.375)]
    assert rows[1]["deployed/success/seed_5"] == 0.5


def read_history(path):
    """Yield the rows of history in a log of wandb.

    The file has 7 bytes, then records of a checksum (4 bytes), a length (2), a kind (1; the value 1 is a whole record).
    """
    from wandb.proto import wandb_internal_pb2

    data = path.read_bytes()[7:]
    assert len(data) < 2**15, "a second block would begin here"
    while data:
        length, kind = int.from_bytes(data[4:6], "little"), data[6]
        assert kind == 1
        record = wandb_internal_pb2.Record.FromString(data[7 : 7 + length])
        data = data[7 + length :]
        if record.WhichOneof("record_type") == "history":
            items = record.history.item
            yield {(item.key or "/".join(item.nested_key)): json.loads(item.value_json) for item in items}


class ListLog:
    """A log that keeps the metrics in memory."""

    def __init__(self):
        self.successes, self.closed = [], 0

    def log(self, step, metrics):
        self.successes.append(metrics["deployed/success"])

    def close(self):
        self.closed += 1


def test_any_object_with_log_and_close_is_a_log(tmp_path):
    run = {**TINY_RUN, **TINY, "steps": 80}
    log = ListLog()
    result = train("tabletop_organization", "naive", logs=[log, "tensorboard"], out=tmp_path / "run", **run)
    assert log.closed == 1
    np.testing.assert_array_equal(np.stack(log.successes, axis=1), result.metrics["deployed/success"])
    assert RunFolder.open(tmp_path / "run").logs == ("tensorboard",)
    assert list((tmp_path / "run/tensorboard").iterdir())


@pytest.mark.parametrize(
    ("log", "message"),
    [
        ("mlflow", "unknown log 'mlflow'; choose from tensorboard, wandb"),
        (print, "is not a log"),
        ("tensorboard", r"tensorboard writes into a run folder: pass one with out="),
    ],
)
def test_a_log_that_cannot_be_opened_is_refused_and_nothing_is_written(tmp_path, log, message):
    out = None if log == "tensorboard" else tmp_path / "run"
    with pytest.raises(ValueError, match=message):
        train("tabletop_organization", "naive", logs=[log], out=out, **TINY_RUN, **TINY)
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(("name", "library"), [("tensorboard", "tensorboardX"), ("wandb", "wandb")])
def test_a_missing_library_is_an_error_that_names_the_extra(tmp_path, monkeypatch, name, library):
    monkeypatch.setitem(sys.modules, library, None)
    with pytest.raises(ValueError, match=rf"pip install 'earl-jax\[{name}\]'"):
        LOGS[name](make_folder(tmp_path / "run", name), 0)
