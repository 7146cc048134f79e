"""The physics engine of a run: by name, or the fastest by measured costs."""

import pytest

from earl_jax.envs import chosen_engine, for_lanes, make, with_engine
from earl_jax.physics import EngineCost, engine_choice, fastest_engine


def test_engines_are_chosen_by_name_and_a_missing_one_is_an_error_that_names_its_extra(monkeypatch, env):
    door = make("sawyer_door")
    assert (chosen_engine(door), chosen_engine(for_lanes(door, 2))) == ("auto", engine_choice.DEFAULT_ENGINES["cpu"])
    assert chosen_engine(env) == chosen_engine(for_lanes(env, 2)) == "kinematic"
    assert with_engine(door, "mjx") == make("sawyer_door", engine="mjx")
    with pytest.raises(ValueError, match="engine 'bullet' is not one of auto, mjx, warp, c"):
        make("sawyer_door", engine="bullet")
    with pytest.raises(ValueError, match="plain arithmetic"):
        with_engine(env, "c")
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(ValueError, match="'warp' is not installed: pip install 'warp-lang"):
        make("sawyer_door", engine="warp")


@pytest.mark.parametrize(
    ("task", "cores", "warp", "lanes", "engine"),
    [
        ("minitaur_pen", 16, False, 50, "c"),
        ("minitaur_pen", 16, False, 400, "c"),
        ("minitaur_pen", 16, False, 600, "mjx"),
        ("minitaur_pen", 4, False, 200, "mjx"),
        ("sawyer_door", 16, True, 500, "c"),
        ("sawyer_door", 16, True, 1000, "warp"),
        ("sawyer_door", 16, False, 1000, "c"),
    ],
)
def test_auto_takes_the_engine_that_was_measured_to_be_the_fastest_beside_a_gpu(
    monkeypatch, task, cores, warp, lanes, engine
):
    cost = make(task).engine_cost
    assert fastest_engine(cost, lanes) == "c", "on a CPU"
    monkeypatch.setattr(engine_choice, "default_backend", lambda: "gpu")
    monkeypatch.setattr(engine_choice, "core_count", lambda: cores)
    monkeypatch.setattr(engine_choice, "has_warp", lambda: warp)
    assert fastest_engine(cost, lanes) == for_lanes(make(task), lanes).engine == engine
    assert fastest_engine(cost, 1001) != "warp", "more lanes can have more contacts than warp has room for"
    assert for_lanes(make(task, engine="c"), lanes).engine == "c"


@pytest.mark.parametrize("cost", [None, EngineCost(host=1.0)])
def test_auto_takes_the_default_engine_without_a_cost_of_the_device(monkeypatch, cost):
    monkeypatch.setattr(engine_choice, "default_backend", lambda: "gpu")
    assert fastest_engine(cost, 10_000) == engine_choice.DEFAULT_ENGINES["gpu"]
