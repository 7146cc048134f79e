"""Checkpoints are restored whole, or an error names the damaged file."""

import errno
import json
import os
import re
import shutil

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from earl_jax.runs import checkpoint, manifest
from earl_jax.runs.files import DamagedWarning
from tests.conftest import advance, assert_equal_trees, make_train_state, take_lane, tiny_method


@pytest.fixture(scope="module")
def state(problem):
    method = tiny_method("fbrl")
    return advance(problem, method, make_train_state(problem, method, [0, 1]), 40)


def at_step(state, step):
    return state.replace(step=jnp.asarray(step, jnp.int32))


def written_rows(replay):
    row = int(replay.row)
    return replay.state[: row + 1], replay.action[:row], replay.flags[:row], replay.counts, replay.demos, replay.row


def largest_file(path):
    return max((file for file in path.rglob("*") if file.is_file()), key=lambda file: file.stat().st_size)


def flip_bit(path):
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(bytes(data))


def test_a_saved_state_is_restored(tmp_path, state):
    checkpoint.save(tmp_path, state)
    restored = checkpoint.restore(tmp_path, jax.eval_shape(lambda: state))
    assert_equal_trees(restored.lanes, state.lanes)
    assert_equal_trees(written_rows(restored.replay), written_rows(state.replay))
    assert int(restored.step) == 40


def test_a_larger_buffer_keeps_both_ends_of_the_index(tmp_path, problem, state):
    checkpoint.save(tmp_path, state)
    larger = make_train_state(problem, tiny_method("fbrl"), [0, 1], steps=500)
    restored = checkpoint.restore(tmp_path, larger).replay
    for lane in range(2):
        first, second = (int(count) for count in restored.counts[lane])
        np.testing.assert_array_equal(restored.index[:first, lane], state.replay.index[:first, lane])
        np.testing.assert_array_equal(restored.index[-second:, lane], state.replay.index[-second:, lane])
    assert restored.capacity == larger.replay.capacity


def test_lanes_are_saved_in_separate_folders_and_restored_together(tmp_path, problem):
    method = tiny_method("fbrl", lanes=3)
    state = advance(problem, method, make_train_state(problem, method, [0, 1, 2]), 40)
    folders = [tmp_path / "first", tmp_path / "second"]
    for folder, span in zip(folders, (slice(0, 1), slice(1, 3)), strict=True):
        checkpoint.save(folder, state, span)
        assert checkpoint.newest(folder) == 40
    shapes = jax.eval_shape(lambda: state)
    restored = checkpoint.restore_together(folders, [1, 2], shapes)
    assert_equal_trees(restored.lanes, state.lanes)
    assert_equal_trees(written_rows(restored.replay), written_rows(state.replay))
    assert_equal_trees(restored.replay.index, state.replay.index)
    shapes_of_two = jax.eval_shape(lambda: make_train_state(problem, tiny_method("fbrl"), [1, 2]))
    second = checkpoint.restore(folders[1], shapes_of_two)
    assert_equal_trees(second.lanes, take_lane(state.lanes, slice(1, None)))
    np.testing.assert_array_equal(second.replay.state[:41], state.replay.state[:41, 1:])
    with pytest.raises(ValueError, match="does not belong to this run"):
        checkpoint.restore_together(folders, [2, 1], shapes)
    shutil.rmtree(folders[0])
    assert checkpoint.newest(folders[0]) == 0
    with pytest.raises(ValueError, match=r"steps \[0, 40\] can't continue in one program"):
        checkpoint.restore_together(folders, [1, 2], shapes)


def test_the_two_newest_checkpoints_are_kept_and_an_unfinished_one_is_ignored(tmp_path, state):
    for step in (40, 80, 120):
        checkpoint.save(tmp_path, at_step(state, step))
    (tmp_path / "part-160").mkdir()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["000000080", "000000120", "part-160"]
    assert int(checkpoint.restore(tmp_path, state).step) == 120


def test_a_damaged_checkpoint_is_skipped_with_a_warning(tmp_path, state):
    checkpoint.save(tmp_path, state)
    newest = checkpoint.save(tmp_path, at_step(state, 80))
    flip_bit(largest_file(newest))
    with pytest.warns(DamagedWarning, match=r"000000080 is damaged: .* continuing from 000000040"):
        restored = checkpoint.restore(tmp_path, state)
    assert_equal_trees(restored.lanes, state.lanes)
    assert int(restored.step) == 40
    assert checkpoint.save(tmp_path, at_step(state, 80)) == newest
    assert int(checkpoint.restore(tmp_path, state).step) == 80


def test_lanes_are_restored_together_from_a_step_that_is_whole_in_every_folder(tmp_path, state):
    folders = [tmp_path / "first", tmp_path / "second"]
    for folder, span in zip(folders, (slice(0, 1), slice(1, 2)), strict=True):
        for step in (40, 80):
            checkpoint.save(folder, at_step(state, step), span)
    flip_bit(largest_file(folders[1] / "000000080"))
    with pytest.warns(DamagedWarning, match="second/000000080 is damaged"):
        assert int(checkpoint.restore_together(folders, [1, 1], state).step) == 40


@pytest.fixture(scope="module")
def saved(tmp_path_factory, problem):
    state = make_train_state(problem, tiny_method("fbrl"), [0, 1])
    return checkpoint.save(tmp_path_factory.mktemp("saved"), at_step(state, 40)), state


@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(where=st.floats(0, 1, exclude_max=True), bit=st.integers(0, 7), number=st.integers(0, 10**6))
def test_every_flipped_bit_is_detected(saved, where, bit, number):
    path, state = saved
    files = sorted(file for file in path.rglob("*") if file.is_file() and file.stat().st_size)
    victim = files[number % len(files)]
    before = victim.read_bytes()
    data = bytearray(before)
    data[int(where * len(data))] ^= 1 << bit
    victim.write_bytes(bytes(data))
    try:
        with pytest.raises(ValueError, match="is damaged"):
            checkpoint.restore(path.parent, state)
    finally:
        victim.write_bytes(before)


def test_a_manifest_cannot_name_a_file_outside_its_checkpoint(tmp_path, state):
    path = checkpoint.save(tmp_path / "here", state)
    (tmp_path / "secret").write_text("mine")
    body = json.loads((path / "manifest.json").read_text())
    body.pop("checksum")
    body["files"]["../../secret"] = manifest.checksum(tmp_path / "secret")
    (path / "manifest.json").write_text(manifest.manifest_text(body))
    with pytest.raises(ValueError, match="points outside"):
        checkpoint.restore(tmp_path / "here", state)


def test_neither_a_symbolic_link_nor_a_missing_folder_is_a_checkpoint(tmp_path, state):
    path = checkpoint.save(tmp_path / "there", state)
    (tmp_path / "here").mkdir()
    (tmp_path / "here" / path.name).symlink_to(path)
    for folder in ("here", "nowhere"):
        assert checkpoint.restore(tmp_path / folder, state) is None


def test_a_failed_write_leaves_the_older_checkpoints(tmp_path, state, monkeypatch):
    checkpoint.save(tmp_path, state)

    def fail(path, tree):
        path.mkdir()
        raise RuntimeError("No space left on device\nand a long story")

    monkeypatch.setattr(checkpoint, "_write", fail)
    with pytest.raises(
        OSError, match=r"000000080 can't be written: No space left on device; older checkpoints are unchanged"
    ):
        checkpoint.save(tmp_path, at_step(state, 80))
    assert [path.name for path in tmp_path.iterdir()] == ["000000040"]
    assert int(checkpoint.restore(tmp_path, state).step) == 40


DAMAGE = {
    "bit": (lambda path: flip_bit(largest_file(path)), "{} does not match its checksum"),
    "truncated": (lambda path: os.truncate(largest_file(path), 9), "{} does not match its checksum"),
    "missing": (lambda path: largest_file(path).unlink(), "{} is missing"),
    "manifest": (lambda path: (path / "manifest.json").write_text("{"), "manifest.json cannot be read"),
    "renamed": (lambda path: path.rename(path.with_name("000000080")), "manifest.json names step 40"),
}


@pytest.mark.parametrize("kind", DAMAGE)
def test_an_error_names_the_damaged_file(tmp_path, state, kind):
    path = checkpoint.save(tmp_path, state)
    damage, message = DAMAGE[kind]
    message = message.format(largest_file(path).name)
    damage(path)
    with pytest.raises(ValueError, match=f"is damaged: .*{re.escape(message)}"):
        checkpoint.restore(tmp_path, state)


def test_a_checkpoint_of_other_shapes_is_refused(tmp_path, problem, state):
    checkpoint.save(tmp_path, state)
    other = make_train_state(problem, tiny_method("fbrl", hidden_sizes=[8, 8]), [0, 1])
    with pytest.raises(ValueError, match="does not belong to this run"):
        checkpoint.restore(tmp_path, other)


def test_a_checkpoint_that_cannot_be_removed_yet_does_not_stop_the_next_one(tmp_path, state, monkeypatch):
    def fail(path, **_):
        raise OSError(errno.ENOTEMPTY, "a file in it is still read by another host", path)

    monkeypatch.setattr(shutil, "rmtree", fail)
    for step in (40, 80, 120, 160):
        checkpoint.save(tmp_path, at_step(state, step))
    assert checkpoint.saved_steps(tmp_path) == [120, 160]
    monkeypatch.undo()
    checkpoint.save(tmp_path, at_step(state, 200))
    assert sorted(path.name for path in tmp_path.iterdir()) == ["000000160", "000000200"]


def test_a_file_that_cannot_be_read_is_damage(tmp_path, state, monkeypatch):
    for step in (40, 80):
        checkpoint.save(tmp_path, at_step(state, step))
    digest = manifest.checksum

    def unreadable(path):
        if "000000080" in str(path):
            raise OSError(errno.EIO, "Input/output error", str(path))
        return digest(path)

    monkeypatch.setattr(manifest, "checksum", unreadable)
    with pytest.warns(DamagedWarning, match="000000080 is damaged: .*Input/output error"):
        assert int(checkpoint.restore(tmp_path, state).step) == 40


def test_checkpoints_of_a_billion_steps_are_in_order(tmp_path):
    for name in ("999999999", "1000000000"):
        (tmp_path / name).mkdir()
    assert checkpoint.newest(tmp_path) == 10**9


def test_a_checkpoint_of_a_hundred_million_steps_is_written_again(tmp_path, state):
    for _ in range(2):
        checkpoint.save(tmp_path, at_step(state, 10**8))
    assert int(checkpoint.restore(tmp_path, state).step) == 10**8
