"""Options: known names, values of the default's type, messages with the valid choices; seeds; the limit of time."""

import dataclasses
import re
import time
from typing import Literal

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flax import struct

from earl_jax import SAC, InputError, make, make_algo, train
from earl_jax.algos.naive import Naive
from earl_jax.cli.arguments import parse_minutes, parse_options
from earl_jax.options.values import Interval, TimeLimit, check, check_intervals, parse_whole
from earl_jax.protocol import Deployment, setting_of
from tests.envs.chain import Chain


@dataclasses.dataclass
class Example:
    rate: float = 0.5
    size: int = 8
    fast: bool = False
    word: str = "a"
    layers: tuple[int, ...] = (8,)
    shares: tuple[float, ...] = (0.5, 0.5)
    parts: tuple[object, ...] = ()
    limit: float | None = None
    weight: float = 1


@pytest.mark.parametrize(
    "options",
    [
        {"rate": 1}, {"rate": np.array([0.1, 0.2])}, {"size": np.int64(3)}, {"fast": True}, {"fast": np.array([1.0, 0.0])},
        {"fast": np.True_},
        {"layers": (4, 4)}, {"shares": (0, 0.25)}, {"shares": ()}, {"parts": ("a", 1)},
        {"limit": None}, {"limit": 2.0}, {"word": "b"},
        {"weight": 0.5}, {"weight": -1},
    ],
)  # fmt: skip
def test_values_of_the_right_type_are_accepted(options):
    check("example", Example, options)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"speed": 1}, "example has no option 'speed'; choose from rate, size, fast, word, layers, shares, parts, limit, weight"),
        ({"rate": "fast"}, "rate must be a finite number, not 'fast'"), ({"rate": np.nan}, "rate must be a finite number"),
        ({"rate": True}, "rate must be a finite number"), ({"limit": "much"}, "limit must be a finite number or null"),
        ({"size": 2.5}, "size must be a whole number of at least 0, not 2.5"), ({"size": -1}, "size must be a whole number"),
        ({"fast": "no"}, "fast must be true or false, not 'no'"), ({"fast": np.array([1, 2])}, "fast must be true or false"),
        ({"word": 3}, "word must be text, not 3"),
        ({"layers": ()}, "layers must be a list of whole numbers of at least 1, such as [256,256]"),
        ({"layers": (8, 0)}, "whole numbers of at least 1"),
        ({"shares": (0.5, "much")}, "shares must be a list, each of its values a finite number, not (0.5, 'much')"),
        ({"shares": 0.5}, "shares must be a list"), ({"parts": 1}, "parts must be a list, not 1"),
    ],
)  # fmt: skip
def test_unknown_options_and_wrong_types_are_refused(options, message):
    with pytest.raises(ValueError, match=re.escape(message)):
        check("example", Example, options)


@dataclasses.dataclass
class Postponed:
    limit: "float | None" = None
    most: "int | None" = 5
    mode: "Literal['a', 'b']" = "a"
    other: "Literal[1, 2] | None" = None


def test_the_types_of_options_can_be_text():
    """As in a module that postpones the evaluation of its annotations."""
    check("example", Postponed, {"limit": None, "most": None})
    with pytest.raises(ValueError, match="limit must be a finite number or null, not 'much'"):
        check("example", Postponed, {"limit": "much"})
    with pytest.raises(ValueError, match="mode 'c' is not one of a, b"):
        check_intervals("example", Postponed(mode="c"))  # pyright: ignore[reportArgumentType]
    with pytest.raises(ValueError, match="mode None is not one of a, b"):
        check_intervals("example", Postponed(mode=None))  # pyright: ignore[reportArgumentType]
    with pytest.raises(ValueError, match="other 3 is not one of 1, 2"):
        check_intervals("example", Postponed(other=3))  # pyright: ignore[reportArgumentType]
    check_intervals("example", Postponed(other=2))


@pytest.mark.parametrize(
    ("interval", "inside", "outside"),
    [
        ("[0, 1)", [0, 0.999, np.array([0.0, 0.5])], [1, -1e-9, np.array([0.5, 1.0]), float("nan")],),
        ("(0, 1]", [1, 1e-30], [0, 1e308, "high", "0.5", ["0.5"], True, {}, 0.5 + 1j]),
        ("[1, 2147483647]", [1, 2**31 - 1], [0, 2**31, 10**400]),
    ],
)  # fmt: skip
def test_an_interval_contains_its_numbers_only(interval, inside, outside):
    assert all(Interval(interval).contains(value) for value in inside)
    assert not any(Interval(interval).contains(value) for value in outside)


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: make_algo("fbrl", learning_rate=1e308), "method 'fbrl': learning_rate must lie in (0, 1], not 1e+308"),
        (lambda: make_algo("fbrl", learning_rate=[3e-4, 0.0]), "learning_rate must lie in (0, 1]"),
        (lambda: make_algo("fbrl", learning_rate=[3e-4, 10**400]), "learning_rate must be a number for each lane"),
        (lambda: make_algo("fbrl", learning_rate=np.array(["3e-4"])), "learning_rate must be a finite number"),
        (lambda: make_algo("fbrl", layer_norm=np.array([True, False])), "layer_norm must be true or false"),
        (lambda: make_algo("naive", discount=1.0), "discount must lie in [0, 1), not 1.0"),
        (lambda: make_algo("naive", discount=jnp.array([0.9, 1.5])), "discount must lie in [0, 1), not [0.89"),
        (lambda: make_algo("naive", discount=jnp.float32(jnp.nan)), "discount must be a finite number, not nan"),
        (lambda: make_algo("naive", demo_share=1.5), "demo_share must lie in [0, 1], not 1.5"),
        (lambda: make_algo("naive", hidden_sizes=[16, 10**9]), "hidden_sizes must lie in [1, 65536]"),
        (lambda: make_algo("naive", random_steps=2**31), "random_steps must lie in [0, 2147483647]"),
        (lambda: make_algo("naive", episode_length=0), "episode_length must lie in [1, 2147483647], not 0"),
        (lambda: make_algo("vaprl", relabel_share=-0.1), "relabel_share must lie in [0, 1]"),
        (lambda: make_algo("r3l", rnd_decay=1), "rnd_decay must lie in [0, 1)"),
        (lambda: make("sawyer_door", substeps=10**9), "substeps must lie in [1, 1000]"),
        (lambda: setting_of("deployment", intervention_chance=1.1), "intervention_chance must lie in [0, 1]"),
        (lambda: setting_of("continuing", goal_change=0), "goal_change must lie in [1, 2147483647]"),
        (lambda: parse_options(("a=1", "b=1", "a=1")), "a is given twice"),
        (lambda: parse_options(("steps=" + 5000 * "9",)), "(5000 characters) is not a value"),
        (lambda: parse_options(("steps=" + 100_000 * "[",)), "(100000 characters) is not a value"),
    ],
)  # fmt: skip
def test_values_outside_their_interval_are_refused_with_the_interval(build, message):
    with pytest.raises(InputError) as raised:
        build()
    assert message in str(raised.value)
    assert len(str(raised.value)) < 300


def test_a_value_that_a_trace_hides_is_accepted():
    rates = jax.vmap(lambda rate: make_algo("naive", learning_rate=rate).learner.learning_rate)(jnp.array([1e-3, 9.0]))
    np.testing.assert_allclose(rates, [1e-3, 9.0])
    assert make_algo("naive", layer_norm=True, learning_rate=jnp.bfloat16(1e-3)).learner.layer_norm


def test_a_value_in_a_class_that_its_dataclass_ignores_is_refused():
    """Such a class used to train with the default of its base."""
    near = dataclasses.make_dataclass("Near", [], bases=(Chain,), namespace={"eval_horizon": 20}, frozen=True)
    patient = type("Patient", (Naive,), {"learner": SAC(random_steps=0)})
    wordy = type("Wordy", (Deployment,), {"alive_steps": 5})
    for build in (near, type("Near", (Chain,), {"eval_horizon": 20}), lambda: train(Chain(), patient()), wordy):
        message = r"the value of \w+ in (Near|Patient|Wordy) is not its default; write `\w+: TYPE"
        with pytest.raises(InputError, match=message):
            build()


def test_a_class_whose_values_autoreload_has_replaced_by_equal_ones_is_accepted():
    far = dataclasses.make_dataclass("Far", [("eval_horizon", int, int("1000"))], bases=(Chain,), frozen=True)
    far.eval_horizon = int("1000")  # an object other than the default of the field
    assert far().eval_horizon == 1000


def test_options_of_an_object_that_are_invalid_or_that_no_program_can_hold_are_named_where_it_is_trained():
    """An array as a static option trained once, and failed in jax with the next array; text failed in jax."""

    class Marked(Naive):
        weights: object = struct.field(pytree_node=False, default=None)
        word: object = 0.0
        mode: Literal["a", "b"] = struct.field(pytree_node=False, default="a")

    late = type("Late", (Naive,), {"__annotations__": {"later_steps": int}, "later_steps": 9})
    for method, message in (
        *[(Marked(SAC(discount=value)), rf"naive: discount must lie .* {value!r}") for value in (1.0, "high", "0.9")],
        (Marked(SAC(batch_size=2.0)), "naive: batch_size must be a whole number, not 2.0"),  # pyright: ignore[reportArgumentType]
        (Marked(weights=np.zeros(2)), r"naive: weights must be a plain value, .* not the array \[0.0, 0.0\]"),
        (Marked(mode="c"), "mode 'c' is not one of a, b"),  # pyright: ignore[reportArgumentType]
        (Marked(SAC), r"the learner must be an object of Learner, not .*did you mean SAC\(\)"),  # pyright: ignore[reportArgumentType]
        (Marked(word="fast"), "word is 'fast', not a number .* mark the field: `word: str = flax.struct.field"),
        (late(), "later_steps is 9, not a number .* mark the field: `later_steps: int = flax.struct.field"),
        (Marked(word=(0.5, np.zeros(3))), r"word.1 has shape \(3,\); pass one value, or one for each of 2 lanes"),
    ):
        with pytest.raises(InputError, match=message):
            train(Chain(), method, seeds=2, steps=10)


@pytest.mark.parametrize(
    ("text", "number"), [("1e6", 1_000_000), ("2_500_000", 2_500_000), ("2.50E6", 2_500_000), ("-3", -3), ("1e0", 1)]
)
def test_whole_numbers_can_have_an_exponent(text, number):
    assert parse_whole(text) == number
    assert isinstance(parse_whole(text), int)


def test_an_option_is_a_whole_number_as_any_argument_is():
    options = parse_options(["size=1e6", "rates=[1e-3,1.0,2.5e1,1e10]"])
    assert repr(options) == "{'size': 1000000, 'rates': [0.001, 1.0, 25, 10000000000.0]}"


@pytest.mark.parametrize("text", ["1.5", "2.55e1", "1_e6", "1e-3", "1e400", "1e19", "e6", "", "nan", "1e", "9" * 5000])
def test_a_number_that_is_not_whole_or_too_large_is_refused(text):
    with pytest.raises(ValueError, match="whole number"):
        parse_whole(text)


def test_a_limit_counts_from_its_construction(monkeypatch):
    now = 1000.0
    monkeypatch.setattr(time, "monotonic", lambda: now)
    limit = TimeLimit.of(0.5)
    assert limit.ends_at == 1030
    assert TimeLimit.of(limit) is limit
    assert TimeLimit.of(None) is None
    now = 1029.9
    assert not limit.passed
    now = 1030.0
    assert limit.passed


@pytest.mark.parametrize("minutes", [0, -1, np.nan, np.inf, "soon", "5", True, [1], 10**400, np.array([1.0])])
def test_other_minutes_are_refused_with_the_valid_interval(minutes):
    with pytest.raises(InputError, match=r"minutes must lie in \(0, inf\), not "):
        TimeLimit.of(minutes)


def test_the_command_line_reads_minutes_and_writes_them():
    assert parse_minutes("1e-3").minutes == 0.001
    assert parse_minutes(None) is None
    for text, shown in [("0", "0.0"), ("-2", "-2.0"), ("nan", "nan"), ("soon", "'soon'"), ("", "''")]:
        with pytest.raises(InputError, match=f"not {shown}$"):
            parse_minutes(text)
    shown = [str(TimeLimit.of(minutes)) for minutes in (1, np.float32(0.5), np.int64(90))]
    assert shown == ["1 minute", "0.5 minutes", "90 minutes"]


def test_values_of_set_are_json_or_as_python_writes_them():
    pairs = "a=True", "b=false", "c=None", "d=null", "e=[1,2]", "f=c", "g=1e3"
    expected = {"a": True, "b": False, "c": None, "d": None, "e": [1, 2], "f": "c", "g": 1000}
    assert parse_options(pairs) == expected
