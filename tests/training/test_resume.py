"""Runs that go on from their folder."""

import dataclasses
import shutil
from unittest.mock import Mock

import numpy as np
import pytest

import earl_jax
from earl_jax import HelpBudget
from earl_jax.algos import SAC
from earl_jax.algos.naive import Naive
from earl_jax.envs.tabletop import TabletopOrganization
from earl_jax.errors import InputError
from earl_jax.metrics.scores import as_decimals
from earl_jax.runs.files import RunWarning
from earl_jax.runs.folder import RunFolder
from earl_jax.training import runner
from tests.cli.process import unchanged
from tests.conftest import TINY, TINY_RUN, assert_equal_trees, tiny_train


@dataclasses.dataclass(frozen=True)
class Meadow(TabletopOrganization):
    demo_file: str | None = "tabletop_organization"
    name = "meadow"


class Patient(Naive):
    name = "patient"


def make_patient(**options):
    return Patient(learner=earl_jax.make_algo("naive", **{**TINY, **options}).learner)


def train_meadow(**options):
    return earl_jax.train(Meadow(), make_patient(), **{**TINY_RUN, **options})


def assert_equal_results(actual, expected):
    assert_equal_trees(actual.train_state.lanes, expected.train_state.lanes)
    assert set(actual.metrics) == set(expected.metrics)
    for name, values in expected.metrics.items():
        np.testing.assert_array_equal(actual.metrics[name], values, err_msg=name)


def test_a_run_resumed_from_its_last_checkpoint_but_one_ends_bit_identical(tmp_path):
    """R3L; VaPRL is resumed in tests/training/test_stopping.py."""
    whole = tiny_train("r3l", out=tmp_path / "whole", checkpoint_every=40)
    shutil.copytree(tmp_path / "whole", tmp_path / "part")
    shutil.rmtree(tmp_path / "part/checkpoints/000000120")
    resumed = earl_jax.resume(tmp_path / "part")
    assert_equal_results(resumed, whole)
    assert (tmp_path / "part/metrics.csv").read_text() == (tmp_path / "whole/metrics.csv").read_text()
    assert [path.name for path in sorted((tmp_path / "part/checkpoints").iterdir())] == ["000000080", "000000120"]


def test_a_finished_run_is_not_trained_again_and_a_longer_one_can_end_where_it_stopped(tmp_path, capsys):
    first = tiny_train("naive", out=tmp_path / "run")
    again = earl_jax.resume(tmp_path / "run", progress=True)
    assert_equal_results(again, first)
    assert "all 120 steps were trained before" in capsys.readouterr().err
    with pytest.raises(ValueError, match="has 120 steps already, more than 80"):
        earl_jax.resume(tmp_path / "run", steps=80)
    RunFolder.open(tmp_path / "run").record(steps=200)
    with pytest.warns(RunWarning, match="now ends at step 120 instead of 200"):
        earl_jax.resume(tmp_path / "run", steps=np.int64(120))
    assert RunFolder.open(tmp_path / "run").config.steps == 120


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"logs": None}, "a list of log objects, not None"),
        ({"logs": ["tensorboard"]}, r"log objects, not \['tensorboard'\]; logs named in train continue"),
        ({"env": "meadow"}, "the task must be an object of Env, not 'meadow'"),
        ({"algo": Patient}, r"the method must be an object of Method, not .*; did you mean Patient\(\)\?"),
        ({"steps": "160"}, "steps must be a whole number, not '160'"),
        ({"steps": 90}, "steps 90 is not a multiple of 40, the run's eval_every; choose 120"),
        ({"env": Meadow(reward_type="dense")}, "this run has the reward_type 'sparse', .* has 'dense'"),
        ({"env": TabletopOrganization()}, "task of this run has the name 'meadow', .* passed has 'tabletop_org"),
        ({"algo": make_patient(discount=0.5)}, "method of this run has the discount 'the default', .* passed has 0.5"),
    ],
)
def test_arguments_of_another_kind_and_objects_of_other_options_are_refused_and_leave_the_run(folder, options, message):
    with unchanged(folder), pytest.raises(InputError, match=message):
        earl_jax.resume(folder, **{"env": Meadow(), "algo": make_patient(), "steps": 160, **options})


@pytest.mark.usefixtures("no_training")
def test_a_run_that_began_with_another_version_of_jax_says_so(folder):
    recorded = RunFolder.open(folder).recorded()["provenance"]
    RunFolder.open(folder).record(provenance=recorded | {"versions": recorded["versions"] | {"jax": "0.4.1"}})
    warned = pytest.warns(RunWarning, match=r"began with jax 0.4.1 \(here .*\), which can change its numbers")
    with warned, pytest.raises(AssertionError, match="training started"):
        earl_jax.resume(folder, env=Meadow(), algo=make_patient())


def test_a_run_can_become_so_short_that_its_replay_evicts_nothing(tmp_path):
    tiny_train("naive", out=tmp_path / "run", steps=200, replay_capacity=150, minutes=1e-9)
    shorter = earl_jax.resume(tmp_path / "run", steps=120)
    assert_equal_results(shorter, tiny_train("naive", replay_capacity=150))


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A run of unregistered objects that was never stopped."""
    return train_meadow(out=tmp_path_factory.mktemp("meadow") / "whole")


@pytest.fixture(scope="module")
def part(tmp_path_factory):
    """The folder of a shorter one, of 80 steps, stopped at step 20."""
    path = tmp_path_factory.mktemp("meadow") / "part"
    train_meadow(out=path, steps=80, minutes=1e-9)
    return path


@pytest.fixture
def folder(part, tmp_path):
    return shutil.copytree(part, tmp_path / "part")


def test_unregistered_objects_train_as_registered_ones_do(whole):
    assert (whole.config.env, whole.config.algo) == ("meadow", "patient")
    assert (whole.env, type(whole.method)) == (Meadow(), Patient)
    expected = tiny_train("naive", reward_scale=10.0)
    np.testing.assert_array_equal(whole.metrics["entropy"], expected.metrics["entropy"])


@pytest.mark.parametrize(
    ("given", "kind", "name", "cls"),
    [({}, "env", "meadow", "Meadow"), ({"env": Meadow()}, "algo", "patient", "Patient")],
)
def test_resuming_without_the_objects_is_an_error_that_says_what_to_register(folder, given, kind, name, cls):
    message = (
        rf"as an object of tests\.training\.test_resume:{cls}, .* earl_jax\.register_{kind}\('{name}', {cls}\), "
        rf"or pass the object to continue the run: earl_jax\.resume\(folder, {kind}=\.\.\.\)"
    )
    with pytest.raises(ValueError, match=message):
        earl_jax.resume(folder, **given)


@pytest.mark.parametrize("registered", [False, True])
def test_resuming_with_the_objects_or_after_registration_ends_bit_identical(folder, whole, registries, registered):
    if registered:
        earl_jax.register_env("meadow", Meadow)
        earl_jax.register_algo("patient", Patient)
    objects = {} if registered else {"env": Meadow(), "algo": make_patient()}
    assert_equal_results(earl_jax.resume(folder, steps=120, **objects), whole)


def test_a_run_with_a_budget_is_resumed_with_the_task_or_with_its_wrapper(tmp_path):
    options = {"steps": 40, "eval_every": 20, "seeds": 2, "eval_episodes": 1, "checkpoint_every": 20}
    env, method = HelpBudget(Meadow(eval_horizon=5), budget=5.0), make_patient(random_steps=40)
    expected = earl_jax.train(env, method, out=tmp_path / "run", **options)
    for given in (env, env.task):
        resumed = earl_jax.resume(tmp_path / "run", env=given, algo=method)
        assert resumed.env == env
        assert_equal_results(resumed, expected)
    assert RunFolder.open(tmp_path / "run").config.setting == {"name": "deployment", "budget": 5.0}


@pytest.mark.parametrize("part_that_fails", ["restore_together", "_advance"])
def test_a_longer_run_that_fails_before_its_first_steps_leaves_its_config(folder, part_that_fails, monkeypatch):
    monkeypatch.setattr(runner, part_that_fails, Mock(side_effect=RuntimeError("out of memory")))
    with unchanged(folder), pytest.raises(RuntimeError, match="out of memory"):
        earl_jax.resume(folder, env=Meadow(), algo=make_patient(), steps=120)


def test_an_earlier_run_is_removed_on_request_only_and_after_the_new_one_is_accepted(tmp_path, capsys):
    out = tmp_path / "run"
    tiny_train("naive", out=out)
    with unchanged(out), pytest.raises(ValueError, match="holds another run"):
        tiny_train("naive", out=out)
    for invalid in ({"steps": 50}, {"logs": ["abacus"]}, {"discount": "high"}, {"devices": 1000}):
        with unchanged(out), pytest.raises(ValueError, match=r".+"):
            tiny_train("naive", out=out, overwrite=True, **invalid)
    for name, function in {"ends_phase": lambda *_: 2, "learn": lambda *_: None}.items():
        odd = type("Odd", (Naive,), {"name": "odd", name: function})(SAC(random_steps=40))
        with unchanged(out), pytest.raises(ValueError, match=f"odd: .*{name}"):
            earl_jax.train(Meadow(), odd, seeds=1, steps=80, eval_every=40, out=out, overwrite=True)
    result = tiny_train("naive", out=out, overwrite=True, seeds=[5, 6])
    assert "removed from the earlier run" in capsys.readouterr().err
    assert RunFolder.open(out).config.seeds == result.seeds == (5, 6)
    np.testing.assert_equal(RunFolder.open(out).table().metrics, result.metrics)
    for name, values in result.metrics.items():
        np.testing.assert_equal(as_decimals(values.astype(np.float32)), values, err_msg=name)
