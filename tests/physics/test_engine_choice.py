"""The physics engine of a run: by name, or the fastest by measured costs."""

import jax
import pytest

from earl_jax.envs import make, with_engine
from earl_jax.physics import EngineCost, engine_choice, fastest_engine


def test_engines_are_chosen_by_name_and_a_missing_one_is_an_error_that_names_its_extra(monkeypatch, env):
    door = make("sawyer_door")
    assert (door.engine, door.resolved_engine) == ("auto", engine_choice.DEFAULT_ENGINES["cpu"])
    assert env.engine == env.resolved_engine == "kinematic"
    assert with_engine(door, "mjx") == make("sawyer_door", engine="mjx")
    with pytest.raises(ValueError, match="choose from auto, mjx, warp, c"):
        make("sawyer_door", engine="bullet")
    with pytest.raises(ValueError, match="plain arithmetic"):
        with_engine(env, "c")
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(ValueError, match=r"'warp' is not installed.*earl-jax\[warp\]"):
        make("sawyer_door", engine="warp")


def test_auto_takes_mjx_on_a_gpu_when_the_lanes_are_too_many_for_the_cores(monkeypatch):
    minitaur, door = make("minitaur_pen").engine_cost, make("sawyer_door").engine_cost
    assert fastest_engine(minitaur, 10_000) == "c"
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    monkeypatch.setattr(engine_choice, "own_cores", lambda: range(16))
    assert [fastest_engine(minitaur, lanes) for lanes in (50, 400, 600)] == ["c", "c", "mjx"]
    assert fastest_engine(door, 500) == "c"
    monkeypatch.setattr(engine_choice, "own_cores", lambda: range(4))
    assert fastest_engine(minitaur, 200) == "mjx"
    assert make("minitaur_pen").for_lanes(200).engine == "mjx"
    assert make("minitaur_pen", walls="floating").for_lanes(200).engine == "mjx"
    assert make("minitaur_pen", engine="c").for_lanes(200).engine == "c"


def test_auto_takes_warp_where_it_is_installed_and_was_measured_to_be_faster(monkeypatch):
    door = make("sawyer_door").engine_cost
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    monkeypatch.setattr(engine_choice, "own_cores", lambda: range(16))
    monkeypatch.setattr(engine_choice, "is_installed", lambda engine: True)
    assert [fastest_engine(door, lanes) for lanes in (50, 500, 1000)] == ["c", "c", "warp"]
    assert fastest_engine(door, 1001) != "warp", "more lanes can have more contacts than warp has room for"
    monkeypatch.setattr(engine_choice, "is_installed", lambda engine: engine != "warp")
    assert fastest_engine(door, 1000) == "c"


@pytest.mark.parametrize("cost", [None, EngineCost(host=1.0)])
def test_auto_takes_the_default_engine_without_a_cost_of_the_device(monkeypatch, cost):
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    assert fastest_engine(cost, 10_000) == engine_choice.DEFAULT_ENGINES["gpu"]
