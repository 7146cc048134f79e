"""Logs of a run: all of them receive the same metrics."""

import contextlib
import sys
from unittest.mock import Mock, call

import numpy as np
import pytest

from earl_jax import make, make_algo, resume
from earl_jax.errors import InputError
from earl_jax.runs.files import RunWarning
from earl_jax.runs.folder import RunFolder
from earl_jax.runs.logging import check_logs, open_logs, scalars
from tests.conftest import make_config, tiny_train

METRICS = {40: {"deployed/success": np.array([0.0, 1.0])}, 80: {"deployed/success": np.array([0.25, 0.5])}}


def make_folder(path, *logs):
    config = make_config(make("tabletop_organization"), make_algo("naive"), seeds=(3, 5))
    return RunFolder.create(path, config, "kinematic", logs)


def log_metrics(folder, since, *steps, others=()):
    """Send the metrics of `steps` to every log of a run that goes on from step `since`."""
    for log in open_logs(folder, others, since):
        for step in steps:
            log.log(step, METRICS[step])
        log.close()


def test_scalars_are_the_mean_and_the_value_of_each_seed():
    expected = {"deployed/success": 0.375, "deployed/success/seed_3": 0.25, "deployed/success/seed_5": 0.5}
    assert scalars((3, 5), METRICS[80]) == expected


@pytest.fixture
def tensorboard(monkeypatch):
    monkeypatch.setitem(sys.modules, "tensorboardX", library := Mock())
    return library.SummaryWriter


@pytest.fixture
def wandb(monkeypatch):
    monkeypatch.setitem(sys.modules, "wandb", library := Mock())
    return library.init


def test_tensorboard_receives_the_metrics_once_and_purges_steps_after_the_checkpoint(tmp_path, tensorboard):
    folder = make_folder(tmp_path / "run", "tensorboard", "tensorboard")
    log_metrics(folder, 0, 40)
    log_metrics(folder, 40, 80)
    first, second = tensorboard.call_args_list
    assert first.args == second.args == (str(folder.path / "tensorboard"),)
    assert (first.kwargs["purge_step"], second.kwargs["purge_step"]) == (None, 41)
    assert first.kwargs["filename_suffix"] != second.kwargs["filename_suffix"]
    expected = [call.add_scalar(name, value, 80) for name, value in scalars((3, 5), METRICS[80]).items()]
    assert tensorboard.return_value.mock_calls[-5:] == [*expected, call.flush(), call.close()]


def test_a_metric_that_is_nan_prints_nothing(tmp_path, caplog):
    pytest.importorskip("tensorboardX", reason="the test needs the extra 'tensorboard'")
    [log] = open_logs(make_folder(tmp_path / "run", "tensorboard"), (), 0)
    log.log(40, {"continuing/back_success": np.array([np.nan, 0.5])})
    log.close()
    assert not caplog.records


def test_wandb_receives_the_metrics_and_a_resumed_run_keeps_its_id(tmp_path, wandb):
    folder = make_folder(tmp_path / "run", "wandb")
    log_metrics(folder, 0, 40)
    log_metrics(RunFolder.open(folder.path), 40, 80)
    for start in wandb.call_args_list:
        assert start.kwargs.items() >= {"id": folder.id, "resume": "allow", "dir": str(folder.path)}.items()
    expected = [call.log(scalars((3, 5), METRICS[step]), step=step) for step in (40, 80)]
    assert wandb.return_value.mock_calls == [expected[0], call.finish(), expected[1], call.finish()]


GONE = BrokenPipeError("its service\nhas gone")


def test_a_log_that_fails_gets_one_warning_and_no_more_metrics(tmp_path, wandb):
    wandb.return_value.log.side_effect = GONE
    folder, other = make_folder(tmp_path / "run", "wandb"), ListLog()
    with pytest.warns(RunWarning, match="the log wandb has failed .* training goes on: its service has gone") as caught:
        log_metrics(folder, 0, 40, 80, others=[other])
    assert len(caught) == 1
    assert (len(other.successes), other.closed) == (2, 1)
    assert wandb.return_value.log.call_count == 1


def test_a_run_of_wandb_that_cannot_start_is_one_line(tmp_path, wandb):
    wandb.side_effect = GONE
    with pytest.raises(InputError, match=r"^wandb: its service has gone; WANDB_MODE=offline needs no account$"):
        open_logs(make_folder(tmp_path / "run", "wandb"), [], 0)


@pytest.mark.slow
@pytest.mark.parametrize("ended", [False, True])
def test_a_real_wandb_offline_is_resumed_and_its_end_costs_no_training(tmp_path, monkeypatch, ended):
    wandb = pytest.importorskip("wandb", reason="the test needs the extra 'wandb'")
    monkeypatch.setenv("WANDB_MODE", "offline")
    monkeypatch.setenv("WANDB_SILENT", "true")

    class EndOfWandb(ListLog):
        """Ends the service of wandb at the first evaluation."""

        def log(self, step, metrics):
            super().log(step, metrics)
            if ended:
                wandb.teardown()

    log, out = EndOfWandb(), tmp_path / "run"
    with pytest.warns(RunWarning, match="the log wandb has failed") if ended else contextlib.nullcontext():
        tiny_train("naive", logs=["wandb", log], out=out, steps=80)
        result = resume(out, steps=160)
    np.testing.assert_equal(result.metrics, tiny_train("naive", steps=160).metrics)
    written = {path.stem for path in (out / "wandb").glob("offline-run-*/*.wandb")}
    assert written == {f"run-{RunFolder.open(out).id}"}


class ListLog:
    """A log that keeps the metrics in memory."""

    def __init__(self):
        self.successes, self.closed = [], 0

    def log(self, step, metrics):
        self.successes.append(metrics["deployed/success"])

    def close(self):
        self.closed += 1


class Shifted(ListLog):
    """A log that changes its metrics, which are those of no other log."""

    def log(self, step, metrics):
        metrics["deployed/success"] += 2.0
        metrics.clear()


class Stuck(ListLog):
    """A log that cannot be closed."""

    def close(self):
        raise OSError("no space left")


def test_the_logs_of_a_run_that_is_made_longer_know_its_new_length(tmp_path):
    class Attached(ListLog):
        def attach(self, folder, logs):
            self.steps = folder.config.steps
            return self

    log = Attached()
    tiny_train("naive", out=tmp_path / "run", steps=80, minutes=1e-9)
    resume(tmp_path / "run", steps=120, logs=[log])
    assert log.steps == 120


def test_any_object_with_log_and_close_is_a_log_and_changes_the_metrics_and_the_end_of_no_other(tmp_path):
    log = ListLog()
    with pytest.warns(RunWarning, match="the log Stuck has failed .*: no space left"):
        result = tiny_train("naive", logs=[Shifted(), Stuck(), log, "tensorboard"], out=tmp_path / "run")
    assert (log.closed, result.step) == (1, result.config.steps)
    assert result.metrics["deployed/success"].max() <= 1.0
    np.testing.assert_array_equal(np.stack(log.successes, axis=1), result.metrics["deployed/success"])
    assert RunFolder.open(tmp_path / "run").logs == ("tensorboard",)
    assert list((tmp_path / "run/tensorboard").iterdir())


@pytest.mark.parametrize(
    ("logs", "message"),
    [
        (["mlflow"], "unknown log 'mlflow'; choose from tensorboard, wandb"),
        ([print], "is not a log"),
        ([ListLog], "ListLog'> is not a log, an object with"),
        (["tensorboard"], r"tensorboard writes into a run folder: pass one with out="),
        *[(logs, rf"logs must be a list, such as \['tensorboard'\], not {logs!r}") for logs in ("tensorboard", None)],
    ],
)
def test_a_log_that_cannot_be_opened_and_what_is_no_list_are_refused_and_nothing_is_written(tmp_path, logs, message):
    out = None if logs == ["tensorboard"] else tmp_path / "run"
    with pytest.raises(InputError, match=message):
        tiny_train("naive", logs=logs, out=out)
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(("name", "library"), [("tensorboard", "tensorboardX"), ("wandb", "wandb")])
def test_a_missing_library_is_an_error_that_names_the_extra(monkeypatch, name, library):
    monkeypatch.setitem(sys.modules, library, None)
    with pytest.raises(ValueError, match=rf"(?i)the log {name} needs {library}: pip install '{library}>="):
        check_logs([name])
