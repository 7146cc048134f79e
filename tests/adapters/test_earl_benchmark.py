"""The interface of the original benchmark: its scripts run with one changed import."""

import pickle

import numpy as np
import pytest

from earl_jax.adapters import earl_benchmark
from earl_jax.adapters.earl_benchmark.task_env import TaskEnv
from earl_jax.adapters.earl_benchmark.wrappers.lifelong_wrapper import LifelongWrapper
from earl_jax.adapters.earl_benchmark.wrappers.persistent_state_wrapper import PersistentStateWrapper
from earl_jax.envs import make
from tests.envs.chain import Chain

HOLD = np.array([0.0, 0.0, -1.0])


def short(**options):
    return earl_benchmark.EARLEnvs("tabletop_manipulation", train_horizon=6, eval_horizon=4, **options)


def test_a_script_of_the_original_runs():
    loader = short(reward_type="sparse", reset_train_env_at_goal=False)
    train_env, eval_env = loader.get_envs()
    assert loader.get_initial_states().shape == (1, 6)
    assert loader.get_goal_states().shape == (4, 6)
    train_env.reset()
    for _ in range(20):
        _, reward, done, info = train_env.step(train_env.action_space.sample())
        assert (type(reward), type(done), isinstance(info, dict)) == (float, bool, True)
        if done:
            train_env.reset()
    assert (train_env.num_interventions, train_env.total_steps) == (4, 20)
    dones = [train_env.step(np.array([1.0, 0.0, -1.0]))[2] for _ in range(6)]
    assert dones == [False] * 3 + [True] * 3, "after 2 steps of 6; it does not reset itself"
    assert train_env.step(HOLD)[0][0] > 0.7
    for _ in range(2):
        eval_env.reset()
        steps = [eval_env.step(HOLD) for _ in range(4)]
        assert [done for _, _, done, _ in steps] == [False, False, False, True]
        assert not eval_env.is_successful(steps[-1][0])


def test_demonstrations_replay_with_their_rewards():
    loader = earl_benchmark.EARLEnvs("tabletop_manipulation")
    env, _ = loader.get_envs()
    demos = loader.get_demonstrations()[0]
    sizes = {"observations": 12, "actions": 3, "rewards": 1, "terminals": 1, "next_observations": 12}
    assert {name: rows.shape for name, rows in demos.items()} == {name: (1241, size) for name, size in sizes.items()}
    assert {demos[name].dtype.name for name in sizes.keys() - {"terminals"}} == {"float32"}
    assert demos["terminals"].dtype == bool
    env.reset()
    np.testing.assert_array_equal(env.reset_goal(demos["observations"][0, 6:]), demos["observations"][0])
    last = int(np.argmax(demos["terminals"]))
    for number in range(last + 1):
        obs, reward, _, info = env.step(demos["actions"][number])
        np.testing.assert_allclose(obs, demos["next_observations"][number], atol=1e-5)
        assert reward == demos["rewards"][number, 0] == env.compute_reward(obs) == info["success"]
    assert env.is_successful()
    assert isinstance(env.is_successful(), bool)
    assert env.is_successful(demos["next_observations"]).sum() == demos["rewards"].sum()
    np.testing.assert_array_equal(env.compute_reward(demos["next_observations"]), demos["rewards"][:, 0])


def test_lifelong_learning_changes_goals_on_a_schedule():
    np.random.seed(3)
    env = short(setup_as_lifelong_learning=True, goal_change_frequency=3).get_envs()
    goals = [env.reset()[6:]]
    for _ in range(60):
        obs, *_ = env.step(HOLD)
        np.testing.assert_array_equal(env.goal, obs[6:])
        goals.append(obs[6:])
    changes = 1 + np.flatnonzero((np.diff(goals, axis=0) != 0).any(axis=1))
    assert len(changes) > 5
    assert (changes % 3 == 0).all()
    env.reset_goal(env.step(HOLD)[0][:6])
    env.step(HOLD)
    assert (env.lifelong_return, env.total_steps, env.num_interventions) == (1.0, 62, 1)


def test_the_next_goal_is_drawn_among_the_task_goals_and_changes_nothing():
    env, _ = short().get_envs()
    before = env.reset()[6:]
    drawn = {tuple(env.get_next_goal().tolist()) for _ in range(40)}
    assert drawn == set(map(tuple, short().get_goal_states().tolist()))
    np.testing.assert_array_equal(env.goal, before)
    np.testing.assert_array_equal(env.reset_goal(env.get_next_goal())[6:], env.goal)


def test_the_wrappers_take_an_env_with_four_tuples():
    class Line:
        place = 0

        def reset(self):
            return self.place, "first"

        def step(self, action):
            self.place += action
            return (self.place, "old"), 0.5, False, {}

        def reset_goal(self):
            return self.place, "new"

    env = LifelongWrapper(PersistentStateWrapper(Line(), 3), 2)
    assert env.reset() == (0, "first")
    steps = [env.step(1) for _ in range(4)]
    assert [obs for obs, *_ in steps] == [(1, "old"), (2, "new"), (3, "old"), (4, "new")]
    assert [done for _, _, done, _ in steps] == [False, False, True, True]
    assert (env.lifelong_return, env.total_steps, env.num_interventions, env.place) == (2.0, 4, 1, 4)
    with pytest.raises(AttributeError, match="close"):
        env.close()


def test_numpys_seed_makes_starts_reproducible():
    def starts(seed):
        np.random.seed(seed)
        env, other = earl_benchmark.EARLEnvs("tabletop_manipulation", wide_init_distr=True).get_envs()
        return [env.reset(), env.reset(), other.reset()]

    np.testing.assert_array_equal(starts(0), starts(0))
    assert len(np.unique(np.array(starts(0) + starts(1))[:, :4], axis=0)) == 6
    env, _ = short().get_envs()
    assert env.seed(5) == [5]
    goals = [env.reset()[6:] for _ in range(8)]
    env.seed(np.int64(5))
    for seed in (-1, 2**32, 1.5, "x"):
        with pytest.raises(ValueError, match="seed must"):
            env.seed(seed)
    np.testing.assert_array_equal(goals, [env.reset()[6:] for _ in range(8)])


@pytest.mark.parametrize("name", ["tabletop_manipulation", "sawyer_door", "sawyer_peg", "kitchen", "minitaur"])
def test_a_released_configuration_is_that_of_the_task(name):
    """tests/envs/test_contract.py has the numbers."""
    task, loader = make(earl_benchmark.ORIGINAL_NAMES.get(name, name)), earl_benchmark.EARLEnvs(name)
    train_env, eval_env = loader.get_envs()
    assert (train_env.observation_space, train_env.action_space) == (task.observation_space, task.action_space)
    assert [env._horizon for env in (train_env, eval_env)] == [task.train_horizon, task.eval_horizon]
    assert loader.get_train_env(lifelong=True)._frequency == task.continuing.goal_change
    assert loader.has_demos() == (name not in ("kitchen", "minitaur"))


def test_a_peg_starts_inserted_in_training_alone_and_the_current_reward_is_that_of_the_step():
    loader = earl_benchmark.EARLEnvs("sawyer_peg", reward_type="dense", reset_train_env_at_goal=True)
    (env, eval_env), goals = loader.get_envs(), loader.get_initial_states()
    inserted = loader.get_goal_states()[0, 4:]
    assert [np.abs(each.reset()[4:7] - inserted).max() < 0.03 for each in (env, eval_env)] == [True, False]
    obs, reward, _, _ = env.step(np.zeros(4))
    assert env.compute_reward() == pytest.approx(reward, rel=1e-6)
    assert abs(env.compute_reward(obs) - reward) > 1e-4
    for goal in (obs[7:], env.get_next_goal(), env.reset_goal()[7:]):
        assert (goals == goal).all(axis=1).any()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"env_name": "tabletop"}, "unknown task 'tabletop'"),
        (
            {"env_name": "sawyer_door", "horizon": 3},
            "no option 'horizon'; choose from .*wide_init_distr, .*train_horizon",
        ),
        ({"env_name": "kitchen", "kitchen_task": "open_microwave"}, "kitchen_task 'open_microwave'"),
        ({"env_name": "tabletop_manipulation", "reset_train_env_at_goal": True}, "cannot start at its goal"),
    ],
)
def test_unsupported_options_are_refused(options, message):
    with pytest.raises(ValueError, match=message):
        earl_benchmark.EARLEnvs(**options)


def test_unsupported_calls_are_refused_and_the_peg_ignores_wide_starts():
    with pytest.raises(ValueError, match="no demos for 'minitaur_pen'"):
        earl_benchmark.EARLEnvs("minitaur").get_demonstrations()
    with pytest.raises(ValueError, match="mode 'human'"):
        short().get_envs()[0].render("human")
    for evaluate in (short().get_envs()[0].is_successful, short().get_envs()[0].compute_reward):
        with pytest.raises(ValueError, match=r"obs has shape \(2, 11\), this task takes \(..., 12\)"):
            evaluate(np.zeros((2, 11)))
    peg = earl_benchmark.EARLEnvs("sawyer_peg", "dense", wide_init_distr=True)
    for samples in (-1, 0, 2.5):
        with pytest.raises(ValueError, match="number of samples must"):
            peg.get_initial_states(samples)
    assert peg._task == make("sawyer_peg", reward_type="dense")


def test_an_env_is_pickled():
    env = short().get_envs()[0]
    env.reset()
    twin = pickle.loads(pickle.dumps(env))
    assert twin.is_successful() == env.is_successful()
    assert (twin.step(HOLD)[0] == env.step(HOLD)[0]).all()


def test_a_task_without_pictures_can_be_stepped():
    env = TaskEnv(Chain())
    assert env.reset().shape == env.step(np.ones(1))[0].shape == (2,)
    with pytest.raises(ValueError, match="'rgb_array' is not supported; this task has None"):
        env.render()
