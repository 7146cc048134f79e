"""Everyone who listens to a run hears the same."""

import json
import time

import numpy as np
import pytest

from earl_jax import make, make_algo, train
from earl_jax.runs.config import RunConfig
from earl_jax.runs.folder import RunFolder
from earl_jax.runs.logging import LOGS, opened, scalars
from tests.conftest import TINY

METRICS = {40: {"deployed/success": np.array([0.0, 1.0])}, 80: {"deployed/success": np.array([0.25, 0.5])}}


def folder_of(path, *logs):
    config = RunConfig.of(make("tabletop_organization"), make_algo("naive"), (3, 5), 120, 40, 2, 40)
    return RunFolder.create(path, config, logs)


def told(folder, since, *steps):
    for log in opened(folder, [], since):
        for step in steps:
            log.log(step, METRICS[step])
        log.close()


def test_a_mean_and_each_seed_have_their_names():
    found = scalars((3, 5), METRICS[80])
    assert found == {"deployed/success": 0.375, "deployed/success/seed_3": 0.25, "deployed/success/seed_5": 0.5}


def test_the_table_is_always_written(tmp_path):
    folder = folder_of(tmp_path / "run")
    told(folder, 0, 40, 80)
    assert [row["deployed/success"] for row in folder.rows()] == [0.0, 1.0, 0.25, 0.5]


def test_tensorboard_hears_the_same_and_forgets_what_is_lived_again(tmp_path):
    events = pytest.importorskip("tensorboardX.event_file_writer", reason="needs the extra tensorboard")
    del events
    folder = folder_of(tmp_path / "run", "tensorboard")
    told(folder, 0, 40, 80)
    told(folder, 40, 80)
    found, purged = [], []
    for path in sorted((folder.path / "tensorboard").iterdir(), key=lambda path: path.stat().st_mtime_ns):
        for event in read_events(path):
            purged += [event.step] if event.HasField("session_log") else []
            found += [(value.tag, event.step, value.simple_value) for value in event.summary.value]
    means = [(step, value) for tag, step, value in found if tag == "deployed/success"]
    assert means == [(40, 0.5), (80, 0.375), (80, 0.375)]
    assert ("deployed/success/seed_3", 80, 0.25) in found
    assert purged == [41]


def read_events(path):
    """Yield what is in an event file: records of a length (8 bytes), its checksum (4), the event, its checksum (4)."""
    from tensorboardX.proto import event_pb2

    data = path.read_bytes()
    while data:
        length = int.from_bytes(data[:8], "little")
        yield event_pb2.Event.FromString(data[12 : 12 + length])
        data = data[16 + length :]


@pytest.mark.slow
def test_wandb_offline_hears_the_same_and_a_resumed_run_keeps_its_name(tmp_path, monkeypatch):
    pytest.importorskip("wandb", reason="needs the extra wandb")
    monkeypatch.setenv("WANDB_MODE", "offline")
    folder = folder_of(tmp_path / "run", "wandb")
    told(folder, 0, 40)
    told(RunFolder.open(folder.path), 40, 80)
    files = sorted((folder.path / "wandb").glob(f"offline-run-*/run-{folder.id}.wandb"))
    assert len(files) == 2
    deadline = time.monotonic() + 20
    while len(rows := [row for file in files for row in read_history(file)]) < 2 and time.monotonic() < deadline:
        time.sleep(0.1)  # its own process writes
    assert [(row["_step"], row["deployed/success"]) for row in rows] == [(40, 0.5), (80, 0.375)]
    assert rows[1]["deployed/success/seed_5"] == 0.5


def read_history(path):
    """Yield the rows of history in a log of wandb: 7 bytes, then records of checksum (4), length (2), kind (1, 1 whole)."""
    from wandb.proto import wandb_internal_pb2

    data = path.read_bytes()[7:]
    assert len(data) < 2**15, "a second block would begin"
    while data:
        length, kind = int.from_bytes(data[4:6], "little"), data[6]
        assert kind == 1
        record = wandb_internal_pb2.Record.FromString(data[7 : 7 + length])
        data = data[7 + length :]
        if record.WhichOneof("record_type") == "history":
            items = record.history.item
            yield {(item.key or "/".join(item.nested_key)): json.loads(item.value_json) for item in items}


class Listener:
    def __init__(self):
        self.heard, self.closed = {}, 0

    def log(self, step, metrics):
        self.heard[step] = metrics["deployed/success"]

    def close(self):
        self.closed += 1


def test_any_object_can_listen_with_or_without_a_folder(tmp_path):
    run = {"seeds": 2, "steps": 80, "eval_every": 40, "eval_episodes": 2, **TINY}
    listener = Listener()
    result = train("tabletop_organization", "naive", logs=[listener, "tensorboard"], out=tmp_path / "run", **run)
    assert listener.closed == 1
    np.testing.assert_array_equal(np.stack([*listener.heard.values()], 1), result.metrics["deployed/success"])
    assert RunFolder.open(tmp_path / "run").logs == ("tensorboard",)
    assert list((tmp_path / "run/tensorboard").iterdir())
    with pytest.raises(ValueError, match=r"tensorboard writes into a run folder: name one with out="):
        train("tabletop_organization", "naive", logs=["tensorboard"], **run)
    with pytest.raises(ValueError, match="unknown log 'mlflow'; choose from tensorboard, wandb"):
        train("tabletop_organization", "naive", logs=["mlflow"], out=tmp_path / "other", **run)
    with pytest.raises(ValueError, match="is no log"):
        train("tabletop_organization", "naive", logs=[print], **run)
    assert not (tmp_path / "other").exists()


@pytest.mark.parametrize(("name", "library"), [("tensorboard", "tensorboardX"), ("wandb", "wandb")])
def test_a_missing_library_names_its_extra(tmp_path, monkeypatch, name, library):
    monkeypatch.setitem(__import__("sys").modules, library, None)
    with pytest.raises(ValueError, match=rf"pip install 'earl-jax\[{name}\]'"):
        LOGS[name](folder_of(tmp_path / "run", name), 0)
