"""Checkpoints come back whole or say which file is not."""

import json
import shutil

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from earl_jax.runs import checkpoint
from earl_jax.runs.files import DamagedWarning
from tests.conftest import advance, assert_same, newborn, tiny_method


@pytest.fixture(scope="module")
def lives(problem):
    method = tiny_method("fbrl")
    return advance(problem, method, newborn(problem, method, [0, 1]), 40)


def used(replay):
    row = int(replay.row)
    return replay.state[: row + 1], replay.action[:row], replay.flags[:row], replay.counts, replay.demos, replay.row


def test_what_is_saved_comes_back(tmp_path, lives):
    checkpoint.save(tmp_path, lives)
    back = checkpoint.restore(tmp_path, jax.eval_shape(lambda: lives))
    assert_same(lives.lanes, back.lanes)
    assert_same(used(lives.replay), used(back.replay))
    assert int(back.step) == 40


def test_a_larger_buffer_keeps_both_ends_of_the_lists(tmp_path, problem, lives):
    checkpoint.save(tmp_path, lives)
    larger = newborn(problem, tiny_method("fbrl"), [0, 1], steps=500)
    back = checkpoint.restore(tmp_path, larger).replay
    for lane in range(2):
        mine, other = (int(count) for count in back.counts[lane])
        np.testing.assert_array_equal(back.index[:mine, lane], lives.replay.index[:mine, lane])
        np.testing.assert_array_equal(back.index[-other:, lane], lives.replay.index[-other:, lane])
    assert back.capacity == larger.replay.capacity


def test_lanes_are_saved_apart_and_come_back_side_by_side(tmp_path, problem):
    method = tiny_method("fbrl", lanes=3)
    lives = advance(problem, method, newborn(problem, method, [0, 1, 2]), 40)
    folders = [tmp_path / "one", tmp_path / "two"]
    for folder, span in zip(folders, (slice(0, 1), slice(1, 3)), strict=True):
        checkpoint.save(folder, lives, span)
        assert checkpoint.newest(folder) == 40
    shapes = jax.eval_shape(lambda: lives)
    back = checkpoint.restore_together(folders, [1, 2], shapes)
    assert_same(lives.lanes, back.lanes)
    assert_same(used(lives.replay), used(back.replay))
    assert_same(lives.replay.index, back.replay.index)
    alone = checkpoint.restore(folders[1], jax.eval_shape(lambda: newborn(problem, tiny_method("fbrl"), [1, 2])))
    assert_same(jax.tree.map(lambda leaf: leaf[1:], lives.lanes), alone.lanes)
    np.testing.assert_array_equal(alone.replay.state[:41], lives.replay.state[:41, 1:])
    with pytest.raises(ValueError, match="not of this experiment"):
        checkpoint.restore_together(folders, [2, 1], shapes)
    shutil.rmtree(folders[0])
    assert checkpoint.newest(folders[0]) == 0
    with pytest.raises(ValueError, match=r"steps \[0, 40\] can't go on in one program"):
        checkpoint.restore_together(folders, [1, 2], shapes)


def at(lives, step):
    return lives.replace(step=jnp.asarray(step, jnp.int32))


def test_the_two_newest_are_kept_and_an_unfinished_one_is_ignored(tmp_path, lives):
    for step in (40, 80, 120):
        checkpoint.save(tmp_path, at(lives, step))
    (tmp_path / "part-160").mkdir()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["000000080", "000000120", "part-160"]
    assert int(checkpoint.restore(tmp_path, lives).step) == 120


def test_of_damaged_ones_the_newest_whole_one_is_taken_and_that_is_said(tmp_path, lives):
    checkpoint.save(tmp_path, lives)
    newest = checkpoint.save(tmp_path, at(lives, 80))
    bit_flipped(largest(newest))
    with pytest.warns(DamagedWarning, match=r"000000080 is damaged: .* going on from 000000040"):
        back = checkpoint.restore(tmp_path, lives)
    assert_same(lives.lanes, back.lanes)
    assert int(back.step) == 40
    assert checkpoint.save(tmp_path, at(lives, 80)) == newest
    assert int(checkpoint.restore(tmp_path, lives).step) == 80


def test_lanes_side_by_side_go_back_to_a_step_that_all_have_whole(tmp_path, problem):
    method = tiny_method("fbrl", lanes=2)
    lives = advance(problem, method, newborn(problem, method, [0, 1]), 40)
    folders = [tmp_path / "one", tmp_path / "two"]
    for folder, span in zip(folders, (slice(0, 1), slice(1, 2)), strict=True):
        for step in (40, 80):
            checkpoint.save(folder, at(lives, step), span)
    bit_flipped(largest(folders[1] / "000000080"))
    with pytest.warns(DamagedWarning, match="two/000000080 is damaged"):
        assert int(checkpoint.restore_together(folders, [1, 1], lives).step) == 40


@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(where=st.floats(0, 1, exclude_max=True), bit=st.integers(0, 7), number=st.integers(0, 10**6))
def test_no_flipped_bit_goes_unseen(saved, where, bit, number):
    path, lives = saved
    files = sorted(file for file in path.rglob("*") if file.is_file() and file.stat().st_size)
    victim = files[number % len(files)]
    before = victim.read_bytes()
    data = bytearray(before)
    data[int(where * len(data))] ^= 1 << bit
    victim.write_bytes(bytes(data))
    try:
        with pytest.raises(ValueError, match="is damaged"):
            checkpoint.restore(path.parent, lives)
    finally:
        victim.write_bytes(before)


@pytest.fixture(scope="module")
def saved(tmp_path_factory, problem):
    lives = newborn(problem, tiny_method("fbrl"), [0, 1])
    return checkpoint.save(tmp_path_factory.mktemp("saved"), at(lives, 40)), lives


def test_a_manifest_cannot_lead_out_of_its_checkpoint(tmp_path, lives):
    path = checkpoint.save(tmp_path / "here", lives)
    (tmp_path / "secret").write_text("mine")
    manifest = json.loads((path / "manifest.json").read_text())
    manifest.pop("checksum")
    manifest["files"]["../../secret"] = checkpoint._checksum(tmp_path / "secret")
    (path / "manifest.json").write_text(checkpoint._manifest(manifest))
    with pytest.raises(ValueError, match="leads out of"):
        checkpoint.restore(tmp_path / "here", lives)


def test_a_link_is_no_checkpoint(tmp_path, lives):
    path = checkpoint.save(tmp_path / "there", lives)
    (tmp_path / "here").mkdir()
    (tmp_path / "here" / path.name).symlink_to(path)
    assert checkpoint.restore(tmp_path / "here", lives) is None


def test_a_checkpoint_that_cannot_be_written_leaves_the_others(tmp_path, lives, monkeypatch):
    checkpoint.save(tmp_path, lives)

    def full(path, tree):
        path.mkdir()
        raise RuntimeError("No space left on device\nand a long story")

    monkeypatch.setattr(checkpoint, "_write", full)
    with pytest.raises(OSError, match=r"000000080 can't be written: No space left on device; those before it"):
        checkpoint.save(tmp_path, at(lives, 80))
    assert [path.name for path in tmp_path.iterdir()] == ["000000040"]
    assert int(checkpoint.restore(tmp_path, lives).step) == 40


def test_no_checkpoint_is_none(tmp_path, lives):
    assert checkpoint.restore(tmp_path / "nowhere", lives) is None


def largest(path):
    return max((file for file in path.rglob("*") if file.is_file()), key=lambda file: file.stat().st_size)


def bit_flipped(path):
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(bytes(data))


DAMAGE = {
    "bit": (bit_flipped, "is not what was written"),
    "truncated": (lambda path: path.write_bytes(path.read_bytes()[:-1]), "is not what was written"),
    "missing": (lambda path: path.unlink(), "is missing"),
}


@pytest.mark.parametrize("kind", DAMAGE)
def test_damage_is_named(tmp_path, lives, kind):
    path = checkpoint.save(tmp_path, lives)
    victim = largest(path)
    damage, message = DAMAGE[kind]
    damage(victim)
    with pytest.raises(ValueError, match=f"{victim.name} {message}"):
        checkpoint.restore(tmp_path, lives)


def test_a_broken_manifest_is_named(tmp_path, lives):
    path = checkpoint.save(tmp_path, lives)
    (path / "manifest.json").write_text("{")
    with pytest.raises(ValueError, match=r"manifest\.json cannot be read"):
        checkpoint.restore(tmp_path, lives)


def test_a_checkpoint_under_another_step_s_name_is_damaged(tmp_path, lives):
    checkpoint.save(tmp_path, lives).rename(tmp_path / "000000080")
    with pytest.raises(ValueError, match=r"damaged: manifest\.json speaks of step 40"):
        checkpoint.restore(tmp_path, lives)


def test_another_experiment_s_checkpoint_is_refused(tmp_path, problem, lives):
    checkpoint.save(tmp_path, lives)
    other = newborn(problem, tiny_method("fbrl", hidden_sizes=[8, 8]), [0, 1])
    with pytest.raises(ValueError, match="not of this experiment"):
        checkpoint.restore(tmp_path, other)
