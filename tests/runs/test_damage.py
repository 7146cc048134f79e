"""Damaged run folders: every command stops at once with one line, or uses what is intact; links are never followed."""

import contextlib
import os
import shutil
import tracemalloc
import warnings

import jax.numpy as jnp
import numpy as np
import pytest

from earl_jax import resume
from earl_jax.errors import InputError
from earl_jax.report.runs import read
from earl_jax.runs import checkpoint
from earl_jax.runs.files import RunWarning
from earl_jax.runs.folder import RunFolder
from earl_jax.runs.policies import save_policies
from earl_jax.runs.table import COLUMNS, Table
from earl_jax.sweeps.worker import open_folder
from tests.cli.process import snapshot, unchanged
from tests.conftest import make_config, make_train_state, tiny_method
from tests.runs import damage

pytestmark = pytest.mark.usefixtures("no_training")


@pytest.fixture(scope="module")
def state(problem):
    return make_train_state(problem, tiny_method("naive"), [0, 1])


@pytest.fixture(scope="module")
def originals(tmp_path_factory, env, state):
    """The folder of a finished run, and that of a run whose newest checkpoint is of step 80."""
    config = make_config(env, tiny_method("naive"))
    folder = RunFolder.create(tmp_path_factory.mktemp("runs") / "finished", config, "kinematic")
    for step in (40, 80, 120):
        folder.append(step, {name: np.array([step / 700, 1.0]) for name in sorted(COLUMNS)})
        checkpoint.save(folder.checkpoints, state.replace(step=jnp.asarray(step, jnp.int32)))
    save_policies(folder.policies, {"w": np.zeros(2)}, step=120, seeds=(0, 1), obs_size=1, action_size=1)
    running = shutil.copytree(folder.path, folder.path.parent / "running")
    shutil.rmtree(running / "checkpoints/000000120")
    return {path.name: path for path in (folder.path, running)}


@pytest.fixture
def finished(originals, tmp_path):
    return shutil.copytree(originals["finished"], tmp_path / "run")


def message_of(action):
    """Return the message of the InputError of `action`, which is a single line of readable length."""
    with pytest.raises(InputError) as info:
        action()
    message = str(info.value)
    assert len(message.splitlines()) == 1
    assert len(message) < 700
    return message


@pytest.mark.parametrize("kind", damage.TABLE)
def test_missing_or_foreign_rows_are_refused_before_training_and_by_every_reader(finished, kind):
    damage.TABLE[kind](finished)
    config = RunFolder.open(finished).config
    for action in (lambda: resume(finished), lambda: read(finished), lambda: open_folder(finished, config)):
        with unchanged(finished):
            assert "metrics.csv is" in message_of(action)


def test_the_message_names_the_checkpoint_whose_rows_are_intact(finished):
    lines = (finished / "metrics.csv").read_text().splitlines(keepends=True)
    (finished / "metrics.csv").write_text("".join(lines[:6]))
    message = message_of(lambda: resume(finished))
    assert "its rows end at step 80, but the newest checkpoint is of step 120; restore the file from a copy" in message
    assert message.endswith(", or delete checkpoints/000000120 to resume from step 80")
    (finished / "metrics.csv").write_text(lines[0])
    again = f"restore the file from a copy, or train again with: earl-jax train --config {finished} --out NEW"
    assert message_of(lambda: resume(finished)).endswith(again)
    (finished / "metrics.csv").write_text("".join(lines[:6]))
    shutil.rmtree(finished / "checkpoints/000000120")
    with pytest.raises(AssertionError, match="training started"):
        resume(finished)
    (finished / "metrics.csv").write_text("".join([lines[0], *lines[2:]]))
    shutil.rmtree(finished / "checkpoints")
    assert message_of(lambda: read(finished)).endswith(again)


def test_a_run_whose_checkpoints_were_removed_is_not_trained_again(finished):
    shutil.rmtree(finished / "checkpoints")
    ways = f"earl_jax.load({str(finished)!r}) or earl-jax show"
    for options in ({}, {"steps": 240}):
        with unchanged(finished):
            message = message_of(lambda options=options: resume(finished, **options))
        assert f"is finished (120 steps) and has no checkpoint; {ways}" in message
    RunFolder.open(finished).record(steps=240)
    assert "has reached step 120 (240 steps) and has no checkpoint" in message_of(lambda: resume(finished))


@pytest.mark.parametrize(("lines", "step"), [(5, 80), (2, 0)], ids=["whole", "damaged"])
def test_a_copy_of_config_and_metrics_is_not_trained_again(finished, lines, step):
    shutil.rmtree(finished / "checkpoints")
    (finished / "policies.npz").unlink()
    RunFolder.open(finished).record(checkpoint_every=240)
    kept = (finished / "metrics.csv").read_text().splitlines(keepends=True)[:lines]
    (finished / "metrics.csv").write_text("".join(kept))
    with unchanged(finished):
        message = message_of(lambda: resume(finished))
    assert f"has reached step {step} (120 steps) and has no checkpoint" in message


def test_a_run_that_ended_before_its_first_checkpoint_is_trained_again_with_a_warning(finished):
    shutil.rmtree(finished / "checkpoints")
    (finished / "checkpoints").mkdir()
    RunFolder.open(finished).record(steps=240, checkpoint_every=120)
    warned = pytest.warns(RunWarning, match="has no checkpoint yet, so its 120 steps are trained again")
    with warned, pytest.raises(AssertionError, match="training started"):
        resume(finished)
    with (
        warnings.catch_warnings(action="error"),
        pytest.raises(ValueError, match="has 120 steps already, more than 40"),
    ):
        resume(finished, steps=40)


def test_damage_after_the_newest_checkpoint_is_mended_by_resuming(originals, tmp_path):
    running = shutil.copytree(originals["running"], tmp_path / "a run")
    whole = (running / "metrics.csv").read_text()
    (running / "metrics.csv").write_text(whole + whole.splitlines(keepends=True)[-1])
    assert f"earl-jax resume '{running}' continues from step 80" in message_of(lambda: read(running))
    assert RunFolder.open(running).table_until(80).steps.tolist() == [40, 80]
    assert (running / "metrics.csv").read_text() == "".join(whole.splitlines(keepends=True)[:5])


def test_ten_gigabytes_are_read_in_little_memory_and_cut_off_by_resuming(finished):
    whole = (finished / "metrics.csv").read_bytes()
    os.truncate(finished / "metrics.csv", 10 << 30)
    tracemalloc.start()
    assert "metrics.csv is damaged: line 8 is not a row of numbers" in message_of(lambda: read(finished))
    with pytest.raises(AssertionError, match="training started"):
        resume(finished)
    assert RunFolder.open(finished).table_until(120).step == 120
    assert tracemalloc.get_traced_memory()[1] < 50 << 20
    tracemalloc.stop()
    assert (finished / "metrics.csv").read_bytes() == whole


@pytest.mark.parametrize("line", [2, 3, 4097, 4098, 10_001])
@pytest.mark.parametrize("row", ["x,0,0", "7,0,0", "1,0"])
def test_the_first_wrong_line_of_a_long_table_is_named(tmp_path, problem, line, row):
    config = make_config(problem.env, tiny_method("naive"), seeds=(5, 3), steps=5000, eval_every=1, checkpoint_every=1)
    lines = ["step,seed,x", *(f"{step},{seed},{step / 7}" for step in range(1, 5001) for seed in (5, 3))]
    path = tmp_path / "metrics.csv"
    path.write_text("\n".join([*lines, ""]))
    table = Table.read(path, config)
    assert (table.step, table.problem) == (5000, "")
    np.testing.assert_equal(table.metrics["x"], np.arange(1, 5001) / 7 * np.ones((2, 1)))
    lines[-1], lines[line - 1] = "also wrong", row
    path.write_text("\n".join([*lines, ""]))
    table = Table.read(path, config)
    assert table.step == (line - 2) // 2
    expected = f"is step 7 of seed 0 instead of step {line // 2} of seed {(5, 3)[line % 2]}"
    cause = expected if row[0] == "7" else "is not a row of numbers"
    assert f"line {line} {cause}" in table.problem


@pytest.mark.parametrize("kind", damage.READABLE)
def test_other_line_ends_are_read_and_replaced(finished, kind):
    metrics, text = RunFolder.open(finished).table().metrics, (finished / "metrics.csv").read_bytes()
    damage.READABLE[kind](finished)
    np.testing.assert_equal(RunFolder.open(finished).table().metrics, metrics)
    RunFolder.open(finished).table_until(120)
    assert (finished / "metrics.csv").read_bytes() == text


def test_further_rows_keep_the_columns_of_the_file(originals, tmp_path):
    folder = RunFolder.open(shutil.copytree(originals["running"], tmp_path / "run"))
    folder.table_until(80)
    scores = {name: np.full(2, number / 7) for number, name in enumerate(sorted(COLUMNS, reverse=True))}
    folder.append(120, {"added": np.ones(2), **scores})
    np.testing.assert_equal({name: values[:, -1] for name, values in folder.table().metrics.items()}, scores)
    del scores["faults"]
    with pytest.raises(InputError, match="columns that this run does not write: faults"):
        folder.append(160, scores)


def test_a_column_that_a_table_needs_is_named(finished):
    path = finished / "metrics.csv"
    path.write_text(path.read_text().replace("deployed/success", "deployed/succes"))
    assert message_of(lambda: resume(finished)).endswith("has no column deployed/success; restore the file from a copy")


@pytest.mark.parametrize(("key", "content", "cause"), damage.CONFIG, ids=lambda part: str(part)[:20])
def test_a_damaged_config_or_entry_of_one_is_one_line(finished, key, content, cause):
    if key == "file":
        (finished / "config.json").write_bytes(content)
    else:
        damage.set_entry(finished, key, content)
    with unchanged(finished):
        assert cause in message_of(lambda: resume(finished))


@pytest.mark.parametrize("log", ['"abacus"', "5"])
def test_an_unknown_log_concerns_training_only(finished, log):
    damage.set_entry(finished, "logs", f"[{log}]")
    assert "choose from tensorboard, wandb" in message_of(lambda: resume(finished))
    assert read(finished).steps.tolist() == [40, 80, 120]


@pytest.mark.parametrize("kind", damage.IGNORED)
def test_other_entries_are_no_checkpoints(finished, kind):
    damage.IGNORED[kind](finished)
    assert checkpoint.newest(finished / "checkpoints") == 120
    assert RunFolder.open(finished).table().step == 120


def test_a_checkpoint_after_the_end_of_the_run_is_refused(finished):
    damage.set_entry(finished, "steps", "80")
    for action in (lambda: resume(finished), lambda: read(finished)):
        assert "checkpoints/000000120 is later than the 80 steps of config.json" in message_of(action)


@pytest.mark.parametrize("name", damage.LINKED_FILES + damage.LINKED_FOLDERS)
def test_a_link_is_named_and_what_it_leads_to_stays(finished, state, tmp_path, name):
    config, path, victim = RunFolder.open(finished).config, finished / name, tmp_path / "victim"
    victim.mkdir()
    (victim / "file").write_text("mine")
    path.parent.mkdir(exist_ok=True)
    shutil.rmtree(path) if path.is_dir() else path.unlink(missing_ok=True)
    path.symlink_to(victim if name in damage.LINKED_FOLDERS else victim / "file")
    for action in (lambda: resume(finished), lambda: RunFolder.create(finished, config, "c", overwrite=True)):
        with unchanged(finished):
            assert name.partition("/events")[0] in message_of(action)
    with contextlib.suppress(OSError):
        checkpoint.save(finished / "checkpoints", state.replace(step=jnp.asarray(120)))
    assert snapshot(victim) == {victim / "file": b"mine"}
