"""Demonstrations from the scripts of tasks: which tasks have one, and what a script decides."""

import dataclasses
from unittest.mock import Mock

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from earl_jax import assets
from earl_jax.envs import DemoScript, DemoStart, demos, make
from earl_jax.envs.tabletop import TabletopOrganization


@dataclasses.dataclass(frozen=True)
class OneGoal(TabletopOrganization):
    """A task of another package with its own script: a pair of demonstrations without noise, and a forward one alone."""

    hold: int | None = None

    name = "my_one_goal"

    @property
    def demonstrations(self):
        demos = super().demonstrations
        expert = jax.jit(demos.expert)
        script = DemoScript(0.0, self._pair_and_forward, self.hold, action=lambda obs: np.array(expert(obs)))
        return dataclasses.replace(demos, script=script)

    def _pair_and_forward(self, seed):
        start = self.with_goal(self.reset(jax.random.key(seed)), jnp.asarray(self.goal_states[1]))
        yield DemoStart(forward=start, backward=None, backward_goal=self.initial_states[0])
        yield DemoStart(forward=start, backward=None, backward_goal=None)


@pytest.mark.parametrize("hold", [None, 60])
def test_a_task_outside_the_package_brings_its_own_script(hold):
    env = OneGoal(hold=hold)
    made = demos.make(env)
    forward, backward = made["forward"], made["backward"]
    assert (forward.ends.sum(), backward.ends.sum()) == (2, 1)
    np.testing.assert_array_equal(forward.goals[0], env.goal_states[1])
    np.testing.assert_array_equal(backward.goals[0], env.initial_states[0])
    end = np.flatnonzero(forward.ends)[0]
    np.testing.assert_array_equal(backward.states[0], forward.next_states[end])
    first = env.demonstrations.expert(np.append(forward.states[0], forward.goals[0]))
    np.testing.assert_allclose(forward.actions[0], first, rtol=1e-6)
    assert (end == 59) == (hold == 60)
    assert forward.rewards[: end + 1].sum() == 1 if hold is None else forward.rewards[end - 4 : end + 1].all()


def test_a_file_that_cannot_be_written_leaves_the_older_one(tmp_path, monkeypatch):
    forward, backward = ({name: assets.demos("sawyer_door", name)} for name in assets.DIRECTIONS)
    demos.save(forward, tmp_path / "mine.npz")
    monkeypatch.setattr(np, "savez_compressed", Mock(side_effect=OSError("disk full")))
    with pytest.raises(OSError, match=r"mine\.npz can't be written: disk full"):
        demos.save(backward, tmp_path / "mine.npz")
    assert [file.name for file in tmp_path.iterdir()] == ["mine.npz"]
    assert assets.demo_directions(str(tmp_path / "mine.npz")) == ("forward",)


def test_a_task_without_a_script_names_the_tasks_with_one():
    choices = "choose from dhand_lightbulb, sawyer_door, sawyer_peg, tabletop_organization"
    with pytest.raises(ValueError, match=f"fish_swim has no demonstration script; {choices}"):
        demos.make(make("fish_swim"))
    with pytest.raises(ValueError, match=f"sawyer_peg has no demonstration script with these options; {choices}"):
        demos.make(make("sawyer_peg", variant="paper"))


@pytest.mark.parametrize("name", ["tabletop_organization", "sawyer_door", "sawyer_peg"])
def test_a_state_can_be_restored_from_a_demonstration(name):
    env = make(name)
    forward = env.demonstrations.load("forward")
    state = env.demonstrations.state_at(jnp.asarray(forward.states[0]), jnp.asarray(forward.goals[0]))
    np.testing.assert_allclose(state.obs, np.concatenate([forward.states[0], forward.goals[0]]), atol=2e-3)
