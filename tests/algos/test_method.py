"""The contract of a method: its functions, and what its phases take."""

import pytest

from earl_jax.algos import SAC, Method, Phase, list_algos, make_algo
from earl_jax.algos.method import FORWARD, PhaseDemos, check_method
from earl_jax.envs import KinematicEnv
from earl_jax.errors import InputError


@pytest.mark.parametrize(
    ("base", "name", "wrong", "expected"),
    [
        (Method, "act", lambda self, key, env, obs, actor, moment, method_state: obs, "self, key, env, actor, obs, .*"),
        (KinematicEnv, "transition", lambda self, action, state: state, "self, state, action"),
        (SAC, "update", lambda self, key, batch: batch, "self, key, agent, batch"),
    ],
)
def test_a_function_with_other_parameters_is_an_error_when_the_class_is_defined(base, name, wrong, expected):
    with pytest.raises(InputError, match=rf"Careless\.{name} must take \({expected}\), not \(self, "):
        type("Careless", (base,), {name: wrong})
    type("Careful", (base,), {name: lambda *arguments: arguments[1]})
    type("Careful", (KinematicEnv,), {"reset": lambda env, rng, wide=False: rng})


@pytest.mark.parametrize(
    ("base", "wrong", "meant"),
    [
        (Method, "end_phase", "ends_phase"),
        (Method, "need_demos", "needs_demos"),
        (SAC, "diagnostic", "diagnostics"),
        (KinematicEnv, "transitions", "transition"),
    ],
)
def test_a_member_that_is_nearly_called_as_an_inherited_one_is_an_error_when_the_class_is_defined(base, wrong, meant):
    with pytest.raises(InputError, match=f"Careless.{wrong} overrides nothing; did you mean '{meant}'"):
        type("Careless", (base,), {wrong: True})
    type("Careful", (base,), {wrong: True, meant: getattr(base, meant)})
    type("Careful", (base,), {wrong: True, "__annotations__": {wrong: bool}})


@pytest.mark.parametrize("demos", [FORWARD, "forward", ("forward",), [FORWARD]])
def test_the_demonstrations_of_a_phase_are_a_tuple(demos):
    with pytest.raises(InputError, match=r"must be a tuple of PhaseDemos, such as \(FORWARD,\), not"):
        Phase(demos)
    with pytest.raises(InputError, match="unknown direction of PhaseDemos 'forwards'; did you mean 'forward'"):
        Phase((PhaseDemos("forwards"),))


@pytest.mark.parametrize("number", [{"controller": -1}, {"length": 0}, {"length": 2.5}])
def test_the_numbers_of_a_phase_are_checked(number):
    with pytest.raises(InputError, match=f"the {next(iter(number))} of a Phase must"):
        Phase(**number)


@pytest.mark.parametrize("phases", [(), Phase(), (FORWARD,), lambda self: (Phase(),)])
def test_phases_that_are_none_are_refused(phases):
    method = type("Empty", (Method,), {"name": "empty", "phases": phases})()
    with pytest.raises(InputError, match="empty: phases must be a tuple of one Phase or more, not"):
        check_method(method)


@pytest.mark.parametrize("number", [{"later_steps": 0.5}, {"refresh_every": 1e3}, {"refresh_batch_size": -1}])
def test_the_numbers_of_a_method_are_checked(number):
    method = type("Odd", (Method,), {"name": "odd", **number})()
    with pytest.raises(InputError, match=f"odd: {next(iter(number))} must"):
        check_method(method)


def test_a_refresh_that_is_never_called_is_refused():
    members = {"name": "idle", "refresh": make_algo("medal").refresh.__func__}
    with pytest.raises(InputError, match="idle: refresh is never called; set refresh_every"):
        check_method(type("Idle", (Method,), members)())
    check_method(type("Idle", (Method,), {**members, "refresh_every": 5})())


def test_a_method_has_at_most_eight_functions_and_each_is_overridden_by_two():
    """CFBRL counts, because it is a method of this repository."""
    functions = [name for name, value in vars(Method).items() if callable(value) and not name.startswith("_")]
    assert len(functions) <= 8
    classes = [type(make_algo(name)) for name in list_algos()]
    for function in functions:
        overriders = {cls.__name__ for cls in classes if function in vars(cls)}
        assert len(overriders) >= 2, (function, overriders)
