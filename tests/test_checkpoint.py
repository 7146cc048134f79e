"""Checkpoints come back whole or say which file is not."""

import json
import shutil

import jax
import numpy as np
import pytest

from earl_jax import checkpoint
from tests.conftest import advance, assert_same, newborn, tiny_method


@pytest.fixture
def lives(loop):
    method = tiny_method("fbrl")
    return advance(loop, method, newborn(loop, method, [0, 1]), 40)


def used(replay):
    row = int(replay.row)
    return replay.state[: row + 1], replay.action[:row], replay.marks[:row], replay.counts, replay.demos, replay.row


def test_what_is_saved_comes_back(tmp_path, lives):
    checkpoint.save(tmp_path, lives)
    back = checkpoint.restore(tmp_path, jax.eval_shape(lambda: lives))
    assert_same(lives.lanes, back.lanes)
    assert_same(used(lives.replay), used(back.replay))
    assert int(back.step) == 40


def test_a_larger_buffer_keeps_both_ends_of_the_lists(tmp_path, loop, lives):
    checkpoint.save(tmp_path, lives)
    larger = newborn(loop, tiny_method("fbrl"), [0, 1], steps=500)
    back = checkpoint.restore(tmp_path, larger).replay
    for lane in range(2):
        mine, other = (int(count) for count in back.counts[lane])
        np.testing.assert_array_equal(back.index[:mine, lane], lives.replay.index[:mine, lane])
        np.testing.assert_array_equal(back.index[-other:, lane], lives.replay.index[-other:, lane])
    assert back.capacity == larger.replay.capacity


def test_lanes_are_saved_apart_and_come_back_side_by_side(tmp_path, loop):
    method = tiny_method("fbrl", lanes=3)
    lives = advance(loop, method, newborn(loop, method, [0, 1, 2]), 40)
    folders = [tmp_path / "one", tmp_path / "two"]
    for folder, span in zip(folders, (slice(0, 1), slice(1, 3)), strict=True):
        checkpoint.save(folder, lives, span)
        assert checkpoint.newest(folder) == 40
    shapes = jax.eval_shape(lambda: lives)
    back = checkpoint.restore_together(folders, [1, 2], shapes)
    assert_same(lives.lanes, back.lanes)
    assert_same(used(lives.replay), used(back.replay))
    assert_same(lives.replay.index, back.replay.index)
    alone = checkpoint.restore(folders[1], jax.eval_shape(lambda: newborn(loop, tiny_method("fbrl"), [1, 2])))
    assert_same(jax.tree.map(lambda leaf: leaf[1:], lives.lanes), alone.lanes)
    np.testing.assert_array_equal(alone.replay.state[:41], lives.replay.state[:41, 1:])
    with pytest.raises(ValueError, match="not of this experiment"):
        checkpoint.restore_together(folders, [2, 1], shapes)
    shutil.rmtree(folders[0])
    assert checkpoint.newest(folders[0]) == 0
    with pytest.raises(ValueError, match=r"steps \[0, 40\] can't go on in one program"):
        checkpoint.restore_together(folders, [1, 2], shapes)


def test_only_the_newest_is_kept_and_an_unfinished_one_is_ignored(tmp_path, loop, lives):
    checkpoint.save(tmp_path, lives)
    later = advance(loop, tiny_method("fbrl"), lives, 40)
    checkpoint.save(tmp_path, later)
    (tmp_path / "part-120").mkdir()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["000000080", "part-120"]
    assert int(checkpoint.restore(tmp_path, later).step) == 80


def test_no_checkpoint_is_none(tmp_path, lives):
    assert checkpoint.restore(tmp_path / "nowhere", lives) is None


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
    files = json.loads((path / "manifest.json").read_text())["files"]
    victim = path / max(files, key=lambda name: (path / name).stat().st_size)
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


def test_another_experiment_s_checkpoint_is_refused(tmp_path, loop, lives):
    checkpoint.save(tmp_path, lives)
    other = newborn(loop, tiny_method("fbrl", hidden_sizes=[8, 8]), [0, 1])
    with pytest.raises(ValueError, match="not of this experiment"):
        checkpoint.restore(tmp_path, other)
