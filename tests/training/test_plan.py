"""The schedule of a program, and hyper-parameters with a lane axis."""

import dataclasses

import jax.numpy as jnp
import pytest

from earl_jax.algos import SAC, Method, Phase, make_algo
from earl_jax.envs import HelpBudget, make
from earl_jax.errors import InputError
from earl_jax.runs.files import RunWarning
from earl_jax.training.plan import join_lanes, make_plan, per_lane, program_structure
from tests.conftest import make_problem, tiny_method


@pytest.mark.parametrize(
    ("random_steps", "every", "chunk_steps"),
    [(1000, 10_000, 1000), (0, 10_000, 1000), (0, 40, 40), (8192, 4096, 512), (7, 40, 1)],
)
def test_a_chunk_divides_both_and_is_short_enough_to_stop_after(problem, random_steps, every, chunk_steps):
    problem = dataclasses.replace(problem, protocol=dataclasses.replace(problem.protocol, eval_every=every))
    plan = make_plan(problem, tiny_method("naive", random_steps=random_steps), lanes=2, steps=every)
    assert plan.chunk_steps == chunk_steps


def test_a_method_has_as_many_controllers_as_the_replay_has_parts(problem):
    """The transitions of a third one used to be dropped, and it learnt from those of the second one."""

    class Crowd(Method):
        name = "crowd"
        phases = tuple(Phase((), controller=number) for number in range(3))

    with pytest.raises(ValueError, match="crowd has 3 controllers, and the replay has parts for 2"):
        make_plan(problem, per_lane(Crowd(SAC(random_steps=20)), 2), lanes=2, steps=120)


def test_the_remedy_for_missing_demonstrations_is_a_script_or_a_life_without_a_budget():
    with pytest.raises(InputError, match="recorded by: earl-jax demos dhand_lightbulb --out FILE"):
        make_plan(make_problem(make("dhand_lightbulb"), eval_every=40), tiny_method("medal"), lanes=2, steps=120)
    helped = make_problem(HelpBudget(make("tabletop_organization"), 20), eval_every=40)
    with pytest.raises(InputError, match="a state of tabletop_organization with a budget has 7 numbers"):
        make_plan(helped, tiny_method("vaprl"), lanes=2, steps=120)


@pytest.mark.parametrize(
    ("algo", "options", "purpose"),
    [("medal", {}, ""), ("vaprl", {}, ""), ("bc", {}, " to clone"), ("naive", {"pretrain_steps": 5}, " to clone")],
)
def test_a_method_that_needs_demonstrations_says_so_before_it_starts_without_them(algo, options, purpose):
    problem = make_problem(make("fish_swim"), eval_every=40)
    with pytest.raises(InputError, match=f"{algo} needs demonstrations{purpose}, and fish_swim has none"):
        make_plan(problem, tiny_method(algo, **options), lanes=2, steps=120)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    ("task", "algo", "options", "changes", "message"),
    [
        ("tabletop_organization", "naive", {"random_steps": 1_000}, {"random_steps": 119},
         "nothing is learnt: random_steps is 1,000, and the run has only 120 steps"),
        ("tabletop_organization", "vaprl", {"refresh_every": 25}, {"refresh_every": 10},
         r"vaprl refreshes every 5 steps, not every 25: .* the 20 steps of a chunk"),
        ("fish_swim", "naive", {"demo_share": 0.5, "cloning": 1.0}, {"demo_share": 0, "cloning": 0},
         "demo_share and cloning without effect: naive has no demonstrations on fish_swim"),
        ("fish_swim", "naive", {"all_demos": True, "keep_demos": True}, {}, "all_demos and keep_demos without effect"),
        ("fish_swim", "naive", {"demo_share": [0.0, 0.5]}, {"demo_share": [0.0, 0.0]}, "demo_share without effect"),
        ("tabletop_organization", "naive", {"pretrain_log_std": [-2.0, -1.0]}, {"pretrain_log_std": -2.0, "pretrain_steps": 1},
         "pretrain_log_std without effect: pretrain_steps is 0"),
        ("tabletop_organization", "naive", {"cloning": 1.0, "cloning_steps": 9}, {"cloning": 1.0, "cloning_final": 0.0},
         "cloning_steps without effect: cloning_final is None"),
        ("tabletop_organization", "naive", {"cloning_final": 0.5}, {"cloning": 0.0, "cloning_final": 0.5},
         "cloning_final without effect: cloning is None"),
        ("tabletop_organization", "naive", {"fixed_temperature": True, "entropy_per_action": [-0.5, -1]},
         {"fixed_temperature": True}, "entropy_per_action without effect: fixed_temperature is True"),
        ("tabletop_organization", "naive", {"learner": "td3", "target_noise": 0.0, "noise_clip": 0.1},
         {"learner": "td3", "noise_clip": 0.1}, "noise_clip without effect: target_noise is 0.0"),
        ("tabletop_organization", "risc", {"switching": False, "switch_share": 0.2}, {"switch_share": 0.2},
         "switch_share without effect: switching is False"),
    ],
)  # fmt: skip
def test_what_the_options_of_a_run_do_not_say_is_warned_of(task, algo, options, changes, message):
    problem = make_problem(make(task), eval_every=40)
    with pytest.warns(RunWarning, match=message):
        make_plan(problem, tiny_method(algo, **options), lanes=2, steps=120)
    make_plan(problem, tiny_method(algo, **changes), lanes=2, steps=120)


def test_integer_leaves_become_floats_and_flags_stay_flags():
    method = per_lane(make_algo("naive", reward_scale=3, timeout_bootstrap=True), 3)
    assert method.learner.reward_scale.dtype == jnp.float32
    assert method.learner.timeout_bootstrap.dtype == bool
    assert method.learner.discount.shape == (3,)


@pytest.mark.parametrize(
    ("algo", "options", "is_shared"),
    [
        ("naive", {"reward_scale": 1.0, "timeout_bootstrap": True}, True),
        ("naive", {"batch_size": 8}, False),
        ("oracle", {}, False),
    ],
)
def test_methods_share_a_program_if_they_differ_in_floats_and_flags_alone(algo, options, is_shared):
    naive, other = tiny_method("naive"), tiny_method(algo, lanes=3, **options)
    assert (program_structure(other) == program_structure(naive)) == is_shared
    if not is_shared:
        with pytest.raises(ValueError, match=f"the lanes of a program must have one method.*: .*{algo}"):
            join_lanes([naive, other])
