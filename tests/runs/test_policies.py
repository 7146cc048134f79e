"""policies.npz: written whole or not at all, and read without trust."""

import jax
import numpy as np
import pytest

from earl_jax.runs.policies import load_policies, load_visits, policies_step, save_policies
from tests.conftest import assert_equal_trees

ACTORS = {"params": {"hidden_0": {"kernel": np.arange(12, dtype=np.float32).reshape(2, 3, 2)}}}


def save(path, actors=ACTORS, visits=None):
    save_policies(path, actors, step=40, seeds=(3, 7), obs_size=3, action_size=1, visits=visits)
    return path


@pytest.fixture
def file(tmp_path):
    return save(tmp_path / "policies.npz")


@pytest.mark.parametrize("stored", [np.float32, np.float16])
def test_policies_are_read_in_the_dtype_of_the_learner(file, stored):
    save(file, jax.tree.map(stored, ACTORS))
    assert policies_step(file) == 40
    actors = load_policies(file, jax.eval_shape(lambda: ACTORS))
    assert_equal_trees(actors, ACTORS)
    assert actors["params"]["hidden_0"]["kernel"].dtype == np.float32
    with np.load(file, allow_pickle=False) as arrays:
        assert arrays["seeds"].tolist() == [3, 7]
        assert "actor['params']['hidden_0']['kernel']" in arrays.files


@pytest.mark.parametrize("damage", [b"", b"no archive", None])
def test_a_damaged_file_is_one_error(file, damage):
    file.write_bytes(file.read_bytes()[:-40] if damage is None else damage)
    with pytest.raises(ValueError, match=r"policies\.npz is damaged"):
        policies_step(file)


@pytest.mark.parametrize("like", [np.zeros((2, 3, 3), np.float32), np.zeros((2, 3, 2), np.float64)])
def test_policies_of_another_run_are_refused(file, like):
    with pytest.raises(ValueError, match=r"does not belong to this run: actor\['params'\]"):
        load_policies(file, {"params": {"hidden_0": {"kernel": like}}})


def test_maps_of_visits_are_read_as_they_were_written(file):
    assert load_visits(file, seeds=2) is None
    visits = np.arange(32, dtype=np.int32).reshape(2, 4, 4)
    save(file, visits=visits)
    assert_equal_trees(load_visits(file, seeds=2), visits)
    assert_equal_trees(load_policies(file, jax.eval_shape(lambda: ACTORS)), ACTORS)


@pytest.mark.parametrize(
    ("shape", "count"), [((3, 4, 4), 0), ((2, 4, 5), 0), ((2, 0, 0), 0), ((2, 4, 4), 0.0), ((2, 4, 4), -1)]
)
def test_maps_of_another_run_or_other_numbers_are_refused(file, shape, count):
    message = r"policies\.npz does not belong to this run: visits are not counts \[2, B, B\]"
    with pytest.raises(ValueError, match=message):
        load_visits(save(file, visits=np.full(shape, count)), seeds=2)
