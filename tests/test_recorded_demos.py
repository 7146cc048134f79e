"""The demonstrations of runs with recordings: recorded where there is a recording, ours in the other direction."""

import numpy as np
import pytest

from benchmarks.paper.recorded_demos import with_recordings
from earl_jax import assets


def write_recording(path, states, size=7):
    observations = np.linspace(0, 1, states * 2 * size).reshape(states, 2 * size)
    np.savez(
        path,
        observations=observations,
        actions=np.zeros((states, 4)),
        rewards=np.zeros((states, 1)),
        next_observations=observations + 1,
        terminals=np.arange(states) == states - 1,
    )
    return path


@pytest.mark.parametrize("recorded", ["forward", "backward"])
def test_a_recording_replaces_our_demonstrations_of_its_direction_alone(tmp_path, recorded):
    other = {"forward": "backward", "backward": "forward"}[recorded]
    demos = with_recordings("sawyer_peg", {recorded: write_recording(tmp_path / "file.npz", states=3)})
    assert demos[recorded].states.shape == (3, 7)
    np.testing.assert_array_equal(demos[other].states, assets.demos("sawyer_peg", other).states)


def test_a_recording_of_another_task_is_refused(tmp_path):
    with pytest.raises(ValueError, match=r"file\.npz has 6 numbers, and one of sawyer_peg 7"):
        with_recordings("sawyer_peg", {"forward": write_recording(tmp_path / "file.npz", states=3, size=6)})
