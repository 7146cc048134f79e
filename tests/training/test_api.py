"""Training from Python: results, hyper-parameters, and invalid input."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import earl_jax
from earl_jax import SAC, Continuing, Learner, Method
from earl_jax.algos.goals import GoalIndices
from earl_jax.algos.naive import Naive
from earl_jax.envs.tabletop import TabletopOrganization
from earl_jax.errors import InputError
from earl_jax.metrics.deployed import WIDE
from earl_jax.metrics.phase_stats import ALIVE, FORWARD, STILL
from earl_jax.runs.config import method_options
from earl_jax.runs.files import RunWarning
from earl_jax.runs.table import COLUMNS
from earl_jax.training import select_seed, train
from tests import conftest
from tests.cli.process import run
from tests.conftest import ALGOS, assert_all_finite, make_train_state, tiny_method, tiny_train, without_shares
from tests.envs.chain import Chain


@pytest.mark.parametrize("algo", ALGOS)
def test_results_have_a_leading_seed_axis(problem, algo):
    result = tiny_train(algo)
    start = make_train_state(problem, tiny_method(algo), [0, 1])
    types = [[jax.typeof(leaf) for leaf in jax.tree.leaves(state)] for state in (start, result.train_state)]
    assert types[0] == types[1], "dtypes and weak types too, so that one program serves all chunks"
    np.testing.assert_array_equal(result.steps, [40, 80, 120])
    assert {values.shape for values in result.metrics.values()} == {(2, 3)}
    assert {*COLUMNS, WIDE, FORWARD, ALIVE, STILL} <= set(result.metrics)
    assert int(result.train_state.step) == 120
    assert_all_finite(without_shares(result.metrics))
    assert result.metrics["entropy"][0, -1] != result.metrics["entropy"][1, -1]


def test_a_seed_is_selected_and_its_policy_can_be_called(env):
    result = tiny_train("fbrl")
    lane = select_seed(result.train_state, 1)
    assert lane.env_state.obs.shape == (env.observation_size,)
    policy = result.policy(1)
    obs = env.reset(jax.random.key(0)).obs
    action = policy(obs)
    assert action.shape == (3,)
    assert (np.abs(action) <= 1).all()
    np.testing.assert_allclose(jax.jit(policy)(jnp.stack([obs, obs]))[1], action, atol=1e-6)
    assert np.abs(result.policy(0)(obs) - action).max() > 1e-6
    with pytest.raises(IndexError, match="no lane 2: there are 2"):
        select_seed(result.train_state, 2)
    with pytest.raises(ValueError, match=r"takes result\.train_state or result\.policies, not Result"):
        select_seed(result, 0)
    assert repr(policy) == "Policy(obs [..., 12] -> action [..., 3], SAC, 16)"
    assert repr(result.policies).startswith("Policy[2](obs")
    assert "  step: int32[]\n" in repr(result.train_state)
    assert "  visits: int32[64, 64]\n" in repr(lane)
    traced = []
    jax.eval_shape(lambda lane: traced.append(repr(lane)), lane)
    assert traced == [repr(lane)]
    for wrong in (obs[:6], obs[0]):
        with pytest.raises(ValueError, match=r"takes \(\.\.\., 12\)"):
            policy(wrong)
    np.testing.assert_array_equal(policy(obs.tolist()), action)
    with jax.enable_x64(True):
        np.testing.assert_array_equal(policy(np.array(obs, float)), action, strict=True)


def test_options_of_task_and_setting_go_by_name_and_a_list_gives_each_lane_its_own_hyper_parameter():
    world = {"seeds": [5, 6], "train_horizon": 70, "intervention_chance": 0.01}
    mixed = tiny_train("naive", **world, reward_scale=[1.0, 5.0], learning_rate=[1e-3, 1e-4])
    same = tiny_train("naive", **world, reward_scale=5.0, learning_rate=1e-4)
    assert (same.env.train_horizon, same.config.setting) == (70, {"name": "deployment", "intervention_chance": 0.01})
    np.testing.assert_array_equal(mixed.metrics["entropy"][1], same.metrics["entropy"][1])
    assert (mixed.metrics["entropy"][0] != same.metrics["entropy"][0]).any()
    with pytest.raises(ValueError, match=r"^reward_scale has shape \(3,\); .* each of 2 lanes"):
        tiny_train("naive", reward_scale=[1.0, 2.0, 3.0])


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"seed": 3}, r"there is no option 'seed'; did you mean seeds=3 \(or seeds=\[3\] for that seed alone\)\?"),
        ({"n_seeds": 3}, r"there is no option 'n_seeds'; did you mean seeds=3\?"),
        ({"learning_rat": 1e-3}, "method 'fbrl' has no option 'learning_rat'; did you mean learning_rate"),
        ({"step": 5}, "did you mean steps.*`earl-jax list fbrl` lists its options"),
        ({"name": "mine"}, "there is no option 'name'"),
        ({"goal_change": 5}, "goal_change is an option of the setting 'continuing', but the setting is 'deployment'"),
        ({"intervention_chance": jnp.float32(0.5)}, "deployment: intervention_chance must be a plain value, not 0.5"),
        ({"env": TabletopOrganization(wide=np.zeros(2, bool))}, "tabletop_organization: wide must be a plain value"),
        ({"setting": Continuing(), "budget": 5}, r"object here: pass dataclasses.replace\(setting, budget=5\)"),
        ({"env": TabletopOrganization(), "wide": True}, r"object here: pass dataclasses.replace\(task, wide=True"),
        ({"algo": earl_jax.make_algo("naive"), "discount": 0.9}, "go with a method's name"),
        ({"env": TabletopOrganization}, r"the task must be a .*; did you mean TabletopOrganization\(\)"),
        ({"algo": type("Mine", (Method,), {})()}, "the class Mine needs a `name`, as in name: ClassVar"),
        ({"algo": SAC()}, r"the method must be a name or an object of Method, not SAC\("),
    ],
)
def test_an_unknown_misplaced_or_invalid_argument_is_refused_with_the_fix(options, message, no_training):
    with pytest.raises(InputError, match=message):
        train(**{"env": "tabletop_organization", "algo": "fbrl", **options})


def test_a_method_keeps_a_reward_scale_of_its_own_learner(registries):
    class Own(Naive):
        learner: Learner = SAC(reward_scale=2.0)
        name = "own"

    earl_jax.register_algo("own", Own)
    task = TabletopOrganization()
    assert [earl_jax.method_for(task, name).learner.reward_scale for name in ("own", "naive")] == [2.0, 10.0]
    assert earl_jax.method_for(task, "own", learner="td3").learner.reward_scale == 2.0


@pytest.mark.usefixtures("no_training")
def test_an_object_with_another_reward_scale_than_the_task_is_named_unless_it_was_chosen(recwarn):
    task = earl_jax.make("tabletop_organization", reward_type="dense")
    for method in (Naive(), Naive(SAC(reward_scale=2.0)), earl_jax.method_for(task, "naive"), "naive"):
        with pytest.raises(AssertionError, match="training started"):
            train(task, method, steps=2000)
    [message] = [str(each.message) for each in recwarn if "reward_scale" in str(each.message)]
    assert message.startswith("reward_scale is 10, the learner's default, but tabletop_organization has 1;")


@pytest.mark.parametrize(
    ("first", "later", "message"),
    [
        (GoalIndices(3, 0), GoalIndices(0, 1), "returned the indices .*3.*are 0 to 2"),
        (GoalIndices(0, 1), GoalIndices(-1, 0), "returned the indices .*-1.*are 0 to 2"),
        (GoalIndices(2, 2), GoalIndices(2, 2), r"returned the indices \[2\] as the task of its lanes; .* are 0 to 1"),
        (1, 1, r"must return GoalIndices\(goal, task\), not an object of .*Tracer"),
    ],
)
def test_a_goal_outside_the_goal_table_or_a_task_that_is_no_task_goal_ends_training(first, later, message):
    """jax would take the nearest index, and the life would earn task reward for reaching an initial state."""

    class Stray(Naive):
        name = "stray"

        def next_goal(self, key, goals, phase, current, method_state):
            return jax.tree.map(functools.partial(jnp.where, current.goal == current.task), first, later)

    with pytest.raises(InputError, match=f"stray: next_goal {message}"):
        train(Chain(), Stray(episode_length=5), seeds=1, steps=20, eval_every=20, eval_episodes=1)


def test_a_goal_outside_the_goal_table_is_named_when_later_goals_are_in_it_again():
    class Passing(Naive):
        name = "passing"

        def next_goal(self, key, goals, phase, current, method_state):
            return GoalIndices(jnp.array([2, 2, 3, 0])[current.goal], jnp.int32(0))

    with pytest.raises(InputError, match=r"passing: next_goal returned the indices \[3\] as the goal of its lanes"):
        train(Chain(), Passing(episode_length=5), seeds=1, steps=40, eval_every=40, eval_episodes=1)


@pytest.mark.parametrize("name", ["obs", "reward"])
def test_a_reset_to_values_that_are_not_finite_is_refused(name):
    """A dense reward that is never finite used to be a fault in each step, and the return of each episode 0."""

    def reset(self, key):
        state = Chain.reset(self, key)
        return state.replace(**{name: getattr(state, name) * jnp.nan})

    with pytest.raises(InputError, match=f"chain: {name} must be finite after reset, not .*nan"):
        train(type("Lost", (Chain,), {"reset": reset})(), "naive", seeds=1, steps=20, eval_every=20, eval_episodes=1)


def test_the_method_of_a_result_trains_again_under_the_options_that_it_had(tmp_path):
    first = tiny_train("naive", learning_rate=1e-3, out=tmp_path / "run")
    again = train(first.env, first.method, seeds=2, steps=120, eval_every=40, eval_episodes=2)
    assert again.config.options == first.config.options
    np.testing.assert_array_equal(again.metrics["critic_loss"], first.metrics["critic_loss"])
    resumed = earl_jax.resume(tmp_path / "run", env=first.env, algo=first.method)
    assert resumed.config.options["learning_rate"] == 1e-3
    assert method_options(tiny_method("naive", learning_rate=np.array([1e-3, 1e-2])))["learning_rate"] == [1e-3, 1e-2]


def test_a_folder_of_the_user_is_expanded_where_no_shell_does(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    result = tiny_train("naive", out="~/a run")
    assert result.folder.path == earl_jax.load("~/a run").folder.path == tmp_path / "home/a run"
    assert run("table", "~/a run", "--out=~/table.md")[0] == 0
    assert not (tmp_path / "~").exists()
    assert (tmp_path / "home" / "table.md").exists()


class Breaking(TabletopOrganization):
    """Tabletop with a dense reward that is not finite once the gripper has moved."""

    name = "breaking"

    def reward(self, obs):
        return jnp.where(obs[..., 0] == 0, 0.0, jnp.nan)


def test_a_task_that_breaks_at_most_steps_is_a_warning_at_the_call():
    with pytest.warns(RunWarning, match="2 of 2 lanes had faults in most of their steps") as caught:
        tiny_train("naive", Breaking(reward_type="dense"), random_steps=120)
    assert {warning.filename for warning in caught} <= {__file__, conftest.__file__}
