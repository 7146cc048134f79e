"""Checkpoints are restored whole, or an error names what is damaged and the one before is used."""

import errno
import os
import shutil
import struct
import tracemalloc
import zipfile
from unittest.mock import Mock

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from earl_jax.runs import checkpoint
from earl_jax.runs.files import RunWarning
from tests.conftest import advance, assert_equal_trees, make_train_state, take_lane, tiny_method


@pytest.fixture(scope="module")
def state(problem):
    method = tiny_method("fbrl")
    return advance(problem, method, make_train_state(problem, method, [0, 1]), 40)


def save(folder, state, *steps, span=slice(None)):
    """Save the lanes `span` of `state` as those of each of `steps`, and return the folder."""
    for step in steps:
        checkpoint.save(folder, state.replace(step=jnp.asarray(step, jnp.int32)), span)
    return folder


def written_rows(replay):
    row = int(replay.row)
    return replay.state[: row + 1], replay.action[:row], replay.flags[:row], replay.counts, replay.demos, replay.row


def test_a_saved_state_is_restored(tmp_path, state):
    lanes = state.lanes.replace(method_state={"half": jnp.ones((2, 3), jnp.bfloat16), "empty": jnp.zeros((2, 0))})
    state = state.replace(lanes=lanes)
    checkpoint.save(tmp_path, state)
    restored = checkpoint.restore(tmp_path, jax.eval_shape(lambda: state))
    assert_equal_trees(restored.lanes, state.lanes)
    assert_equal_trees(written_rows(restored.replay), written_rows(state.replay))
    assert int(restored.step) == 40


@pytest.mark.parametrize("name", ["a[1]", "[proj]", "a\\b", "*", "gs:", "a\nb", "\udcff"])
def test_a_folder_of_any_name_is_written_and_read(tmp_path, state, name):
    checkpoint.save(tmp_path / name / "checkpoints", state)
    assert_equal_trees(checkpoint.restore(tmp_path / name / "checkpoints", state).lanes, state.lanes)


@pytest.fixture
def two_folders(tmp_path, state):
    """The folders of two runs, each with one lane of `state` at steps 40 and 80."""
    return [save(tmp_path / name, state, 40, 80, span=slice(lane, lane + 1)) for lane, name in enumerate("ab")]


def test_lanes_are_saved_in_separate_folders_and_restored_together_but_not_as_others(two_folders, problem, state):
    restored = checkpoint.restore_together(two_folders, [1, 1], jax.eval_shape(lambda: state))
    assert int(restored.step) == 80
    assert_equal_trees(restored.lanes, state.lanes)
    assert_equal_trees(written_rows(restored.replay), written_rows(state.replay))
    assert_equal_trees(restored.replay.index, state.replay.index)
    one_lane = jax.eval_shape(lambda: make_train_state(problem, tiny_method("fbrl", lanes=1), [1]))
    assert_equal_trees(checkpoint.restore(two_folders[1], one_lane).lanes, take_lane(state.lanes, slice(1, None)))
    other = jax.eval_shape(lambda: make_train_state(problem, tiny_method("fbrl", hidden_sizes=[8]), [0, 1]))
    for sizes, like, difference in (
        ([2, 1], state, r"float32\[1, .* there and float32\[2, .* here"),
        ([1, 1], other, r"16\] there and .*8\] here; have the task, the method or the learner changed\?"),
    ):
        with pytest.raises(ValueError, match=f"does not belong to this run: .* is .*{difference}"):
            checkpoint.restore_together(two_folders, sizes, like)
    shutil.rmtree(two_folders[0])
    with pytest.raises(ValueError, match=r"steps \[0, 80\] can't continue in one program"):
        checkpoint.restore_together(two_folders, [1, 1], state)


def test_lanes_are_restored_together_from_a_step_that_is_whole_in_every_folder(two_folders, state):
    flip_bit(two_folders[1] / "000000080/lanes/arrays.npz")
    with pytest.warns(RunWarning, match="b/000000080 is damaged"):
        assert int(checkpoint.restore_together(two_folders, [1, 1], state).step) == 40


def test_the_two_newest_checkpoints_are_kept_and_an_unfinished_one_is_ignored_and_removed(tmp_path, state):
    save(tmp_path, state, 40, 80, 120)
    for name in ("000000160.part", "trial.part_x"):
        shutil.copytree(tmp_path / "000000120", tmp_path / name)
    assert checkpoint.saved_steps(tmp_path) == [80, 120]
    assert int(checkpoint.restore(tmp_path, state).step) == 120
    save(tmp_path, state, 10**9)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["000000120", "1000000000"]
    assert int(checkpoint.restore(tmp_path, state).step) == 10**9


def test_a_link_to_checkpoints_is_refused_and_a_missing_folder_has_none(tmp_path, state):
    assert checkpoint.restore(tmp_path / "there", state) is None
    checkpoint.save(tmp_path / "there", state)
    (tmp_path / "link").symlink_to("there")
    for action in (checkpoint.restore, checkpoint.save):
        with pytest.raises((ValueError, OSError), match="link is a link or not a folder"):
            action(tmp_path / "link", state)


def test_a_failed_write_leaves_the_older_checkpoints(tmp_path, state, monkeypatch):
    checkpoint.save(tmp_path, state)
    monkeypatch.setattr(os, "fsync", Mock(side_effect=OSError(errno.ENOSPC, "No space left on device\nand more")))
    message = r"000000080 can't be written: .*No space left on device; older checkpoints are unchanged"
    with pytest.raises(OSError, match=message):
        save(tmp_path, state, 80)
    assert [path.name for path in tmp_path.iterdir()] == ["000000040"]
    assert int(checkpoint.restore(tmp_path, state).step) == 40


def test_the_first_checkpoint_is_read_back(tmp_path, state, monkeypatch):
    monkeypatch.setattr(os, "fsync", lambda number: os.ftruncate(number, 99))
    with pytest.raises(OSError, match=r"000000040 can't be written: .*000000040 is damaged: .*File is not a zip file"):
        checkpoint.save(tmp_path, state)
    with pytest.raises(OSError, match=f"{tmp_path} can't hold checkpoints: .*; mend this, or choose another folder"):
        checkpoint.try_out(tmp_path)
    monkeypatch.undo()
    checkpoint.try_out(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["000000040"]


def test_a_checkpoint_that_cannot_be_removed_yet_does_not_stop_the_next_one(tmp_path, state, monkeypatch):
    read_elsewhere = OSError(errno.ENOTEMPTY, "a file in it is still read by another host")
    monkeypatch.setattr(shutil, "rmtree", Mock(side_effect=read_elsewhere))
    save(tmp_path, state, 40, 80, 120)
    assert checkpoint.newest(tmp_path) == 120
    monkeypatch.undo()
    save(tmp_path, state, 160)
    assert checkpoint.saved_steps(tmp_path) == [120, 160]


def flip_bit(path):
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(bytes(data))


def file(part, change):
    """Return a damage to the file of arrays of a part of a checkpoint."""
    return lambda path: change(path / part / "arrays.npz")


def arrays(part, write=np.savez, **changed):
    """Return a damage that writes a part with other arrays, None to drop one, and the checksums that fit them."""

    def damage(path):
        with np.load(path / part / "arrays.npz") as stored:
            merged = {**stored, **changed}
        write(path / part / "arrays.npz", **{name: array for name, array in merged.items() if array is not None})

    return damage


def rows(*shape, dtype=np.float32):
    """Return a damage to the replay that gives its states another `shape` and type."""
    return arrays("replay", state=np.zeros(shape, dtype))


def stated(count, method=zipfile.ZIP_STORED):
    """Return a damage to the replay whose states claim another number of rows, with checksums that fit."""

    def damage(path):
        file = path / "replay/arrays.npz"
        with np.load(file) as stored:
            state = stored["state"]
        arrays("replay", state=None)(path)
        header = {"descr": "<f4", "fortran_order": False, "shape": (count or len(state), *state.shape[1:])}
        with zipfile.ZipFile(file, "a", method) as archive, archive.open("state.npy", "w") as member:
            np.lib.format.write_array_header_1_0(member, header)
            member.write(state.tobytes())

    return damage


def long_list(path):
    """Write a zip whose list of members takes 1 GiB, a hole that takes no place on the disk."""
    with path.open("wb") as handle:
        handle.seek(1 << 30)
        handle.write(b"PK\5\6" + struct.pack("<4H2LH", 0, 0, 1, 1, 1 << 30, 0, 0))


DAMAGE = {
    "a bit of the lanes": (file("lanes", flip_bit), "lanes/arrays.npz can't be read: Bad CRC-32"),
    "a bit of the replay": (file("replay", flip_bit), "replay/arrays.npz can't be read: Bad CRC-32"),
    "no file of lanes": (file("lanes", os.unlink), "lanes/arrays.npz can't be read: .* No such file"),
    "no replay": (lambda path: shutil.rmtree(path / "replay"), "replay"),
    "a pipe": (file("lanes", lambda path: (path.unlink(), os.mkfifo(path))), "lanes/arrays.npz can't be read"),
    "renamed": (lambda path: path.rename(path.with_name("000000120")), "it is of step 80"),
    "no step": (arrays("lanes", step=None), "'step'"),
    "a step of text": (arrays("lanes", step=np.array("80x")), "80x"),
    "a pickle": (arrays("lanes", step=np.array([object()])), "Object arrays cannot be loaded when allow_pickle=False"),
    "compressed": (arrays("replay", write=np.savez_compressed), "its arrays are compressed"),
    "bzip2": (stated(None, zipfile.ZIP_BZIP2), "its arrays are compressed"),
    "no rows": (arrays("replay", state=None), "its replay has other arrays"),
    "too many rows": (rows(5000, 2, 12), "its replay has other arrays"),
    "rows of one lane": (rows(1, 1, 6), r"state is float32\[1, 1, 6\] instead"),
    "rows of other numbers": (rows(1, 2, 6, dtype=float), r"state is float64\[1, 2, 6\] instead"),
    "20 MB of rows": (rows(200_000, 2, 12), "its arrays are larger"),
    "a row that is not there": (arrays("replay", mine=np.full((3, 2), 10**6, np.int32)), "mine has numbers that are"),
    "a negative count": (arrays("replay", counts=np.full((2, 2), -1, np.int32)), "counts has numbers that are"),
    "more bytes than its shape": (stated(40), "state.npy has another size than its array"),
    "fewer bytes than its shape": (stated(100_000), "EOF: reading array data"),
    "a list of 1 GiB": (file("lanes", long_list), "its arrays are larger"),
}
"""Damage to a checkpoint, and what the warning says."""


@pytest.fixture(scope="module")
def two_steps(tmp_path_factory, state):
    return save(tmp_path_factory.mktemp("two_steps"), state, 40, 80)


@pytest.mark.parametrize("kind", DAMAGE)
def test_a_damaged_checkpoint_is_named_and_the_one_before_it_is_used(two_steps, tmp_path, state, kind, capfd):
    damage, message = DAMAGE[kind]
    folder = shutil.copytree(two_steps, tmp_path / "run")
    damage(folder / "000000080")
    tracemalloc.start()
    with pytest.warns(RunWarning, match=f"is damaged: .*{message}.*; continuing from 000000040$"):
        restored = checkpoint.restore(folder, state)
    assert tracemalloc.get_traced_memory()[1] < 15 << 20
    tracemalloc.stop()
    assert_equal_trees(restored.lanes, state.lanes)
    assert int(restored.step) == 40
    assert capfd.readouterr().err == ""
    shutil.rmtree(folder / "000000040")
    with pytest.raises(ValueError, match="no older checkpoint is intact"):
        checkpoint.restore(folder, state)
    save(folder, state, checkpoint.newest(folder))
    assert_equal_trees(checkpoint.restore(folder, state).lanes, state.lanes)


@pytest.mark.filterwarnings("ignore::earl_jax.runs.files.RunWarning")
@settings(max_examples=60, deadline=None)
@given(where=st.floats(0, 1, exclude_max=True), bit=st.integers(0, 7), number=st.integers(0, 10**6))
def test_a_flipped_bit_is_detected_or_changes_nothing(two_steps, state, where, bit, number):
    files = sorted(file for file in (two_steps / "000000080").rglob("*") if file.is_file() and file.stat().st_size)
    victim = files[number % len(files)]
    before = victim.read_bytes()
    data = bytearray(before)
    data[int(where * len(data))] ^= 1 << bit
    victim.write_bytes(bytes(data))
    try:
        restored = checkpoint.restore(two_steps, state)
    finally:
        victim.write_bytes(before)
    assert_equal_trees(restored.lanes, state.lanes)
    assert_equal_trees(written_rows(restored.replay), written_rows(state.replay))
