"""Speed: equal tasks of the peers, the plan and ratios of the suite, programs on one device, costs, kernels."""

import importlib.util
import json
import subprocess
import sys
from unittest.mock import Mock, call

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from benchmarks.speed import budget, kernels, method_cost, per_device, suite
from benchmarks.speed.peers.common import DOOR, TABLETOP
from benchmarks.speed.peers.learners import LEARNERS, Batch
from benchmarks.speed.peers.numpy_tabletop import NumpyTabletop
from benchmarks.speed.peers.original import Door
from benchmarks.speed.peers.plan import LANES, RATIOS, Job, plan, ratios
from earl_jax.algos import list_algos, make_algo
from earl_jax.cli.arguments import parse_options
from earl_jax.envs import PAPER_TASKS, make
from earl_jax.sweeps.slots import make_slots
from tests.cli.process import run_code


class CodeJob(Job):
    """A job whose processes execute its `module` as code instead of measuring."""

    @property
    def arguments(self):
        return ("-c", self.module)


def test_the_numpy_tabletop_equals_the_jax_task():
    numpy_env, env = NumpyTabletop(), make(TABLETOP)
    obs, _ = numpy_env.reset(seed=3)
    state = env.with_goal(env.reset(jax.random.key(0)), jnp.asarray(obs[6:]))
    step, expert, rng = jax.jit(env.step), jax.jit(env.demonstrations.expert), np.random.default_rng(0)
    rewards = 0.0
    for number in range(120):
        np.testing.assert_allclose(obs, state.obs, atol=2e-6)
        action = np.asarray(expert(state.obs)) if number % 4 else rng.uniform(-1.5, 1.5, 3).astype(np.float32)
        obs, reward, terminated, truncated, _ = numpy_env.step(action)
        state = step(state, action)
        assert reward == float(state.reward) == terminated
        assert not truncated
        rewards += reward
    assert rewards > 0
    short = NumpyTabletop(horizon=3)
    short.reset(seed=0)
    assert [short.step(np.zeros(3))[3] for _ in range(3)] == [False, False, True]


def test_the_original_door_starts_where_ours_does_and_moves():
    door, env = Door(), make(DOOR, engine="c")
    first = door.reset()
    np.testing.assert_allclose(first, env.reset(jax.random.key(0)).obs, atol=0.02)
    for _ in range(10):
        obs, reward, success = door.step(np.array([1.0, 0.0, 0.0, 0.0]))
    assert 0.02 < obs[0] - first[0] < 0.12
    assert (reward, success) == (0.0, False)


def assert_fits_terminal_rewards(kind):
    """Assert that the learner `kind` learns the value 1 of transitions that end with that reward."""
    learner, rng = LEARNERS[kind](6, 2), np.random.default_rng(0)
    obs, action = rng.normal(size=(64, 6)).astype(np.float32), rng.uniform(-1, 1, (64, 2)).astype(np.float32)
    batch = Batch(obs, action, np.full(64, 0.1, np.float32), np.ones(64, bool), obs)
    before = float(learner.values(obs, action).mean())
    for _ in range(150):
        learner.update(batch)
    assert abs(float(learner.values(obs, action).mean()) - 1.0) < 0.2 < abs(before - 1.0)
    assert learner.act(obs[0]).shape == (2,)


def test_the_jax_learner_of_the_python_loop_fits_terminal_rewards():
    assert_fits_terminal_rewards("jax")


@pytest.mark.slow
@pytest.mark.skipif(importlib.util.find_spec("torch") is None, reason="PyTorch comes with make test-slow")
def test_the_pytorch_learner_of_the_python_loop_fits_terminal_rewards():
    """In its own process: an import of PyTorch's Triton ends one that has run many other tests."""
    code = "from tests.test_benchmarks import assert_fits_terminal_rewards; assert_fits_terminal_rewards('torch')"
    run_code(code)


def test_every_ratio_has_its_rows():
    for device in ("cpu", "gpu"):
        rows = [make_row(job.peer, job.task, job.lanes, 1.0) for job in plan(device)]
        assert [entry["ratio"] for entry in ratios(rows)] == [1.0] * len(RATIOS)


def make_row(peer: str, task: str, lanes: int, rate: float | None) -> dict:
    return {"peer": peer, "task": task, "device": "cpu", "lanes": lanes, "lane_steps_per_s": rate}


def test_a_ratio_is_to_the_fastest_row_that_ran():
    rows = [
        make_row("earl_jax", TABLETOP, LANES, 300.0), make_row("earl_jax", TABLETOP, 5, 900.0),
        make_row("earl_jax", DOOR, LANES, 200.0),
        make_row("sbx", TABLETOP, 1, 20.0), make_row("sbx", TABLETOP, 1, 30.0), make_row("rejax", TABLETOP, LANES, 200.0),
        make_row("brax", TABLETOP, 1, None),
        make_row("original-style, jax", DOOR, 1, 40.0), make_row("original-style, torch", DOOR, 1, 50.0),
    ]  # fmt: skip
    by_peer = {entry["over"]: entry["ratio"] for entry in ratios(rows)}
    assert by_peer == {"sbx": 10.0, "rejax": 1.5, "brax": None, "original-style": 4.0}


def test_a_row_is_the_last_line_that_its_process_prints():
    row = {"peer": "peer", "lane_steps_per_s": 2.5, "start_s": 1.0, "compile_s": 3.0}
    job = CodeJob("peer", TABLETOP, f"print('noise'); print({json.dumps(row)!r})", 1)
    assert suite.measure(job, sys.executable, 60) == row


def test_a_row_that_does_not_run_has_a_reason():
    absent = Job("sbx", TABLETOP, "nowhere", 1)
    assert "No module named" in suite.measure(absent, sys.executable, 60)["reason"]
    assert "time was over" in suite.measure(absent, sys.executable, 0)["reason"]
    assert "no/such/python" in suite.measure(absent, "no/such/python", 60)["reason"]
    slow = suite.measure(CodeJob("peer", TABLETOP, "import time; time.sleep(60)", 1), sys.executable, 1)
    assert "timed out" in slow["reason"]
    assert slow["lane_steps_per_s"] is None


def fake_program(algo, *rates):
    """Return a program that reports one rate after another."""
    return Mock(per_device.Program, algo=algo, reply=Mock(side_effect=[{"steps_per_s": rate} for rate in rates]))


def test_programs_at_once_are_compared_with_each_of_them_alone():
    case = per_device.Case.parse("sawyer_door:naive,fbrl:2")
    assert case.programs() == [("naive",), ("fbrl",), ("naive", "fbrl")]
    whole, half = make_slots(1, [], range(8))[0], make_slots(2, [], range(8))[0]
    alone = [([fake_program("naive", 900.0, 1100.0)], whole), ([fake_program("fbrl", 500.0, 500.0)], whole)]
    together = [fake_program("naive", 800.0, 800.0), fake_program("fbrl", 400.0, 400.0)]
    rows = per_device._rows(case, [*alone, (together, half)], seconds=5, count=2)
    assert together[0].run.call_args_list == [call(5)] * 2
    assert [row["steps_per_s_total"] for row in rows] == [1000.0, 500.0, 1200.0]
    assert rows[-1]["gain"] == pytest.approx(0.8 + 0.8)
    assert rows[-1]["wall_gain"] == pytest.approx((1 / 1000 + 1 / 500) * 400)
    assert per_device.table_rows(rows) == ['    "sawyer_door": {(2, 4): 1.2},']


def test_a_program_that_ends_is_an_error():
    assert per_device.Case.parse("sawyer_peg:naive:4,2").programs() == [("naive",), ("naive",) * 2, ("naive",) * 4]
    program = per_device.Program.__new__(per_device.Program)
    program.algo = "naive"
    program._process = subprocess.Popen([sys.executable, "-c", "print('stray')"], stdout=subprocess.PIPE, text=True)
    with pytest.raises(RuntimeError, match="program of naive ended with code 0"):
        program.reply()
    program._process.stdout.close()


def rate(env, algos, total, gain=1.0):
    programs = str(len(algos.split("+")))
    return {"env": env, "algos": algos, "programs": programs, "steps_per_s_total": str(total), "wall_gain": str(gain)}


def test_the_budget_multiplies_the_papers_steps_by_measured_rates():
    rates = [rate(env, "fbrl", 2500) for env in PAPER_TASKS] + [rate("tabletop_organization", "naive", 5000)]
    rates.append(rate("tabletop_organization", "fbrl+naive", 5000, gain=1.5))
    rows = budget.budget(rates)
    tabletop, door = rows[0], rows[1]
    assert (tabletop["cells"], tabletop["steps"], tabletop["programs"]) == (5, 2_500_000, 2)
    others = 3 * (1 / 2500 + 1 / 5000) / 2
    hours = 2_500_000 * (1 / 2500 + 1 / 5000 + others) / 3600
    assert tabletop["hours_in_turn"] == round(hours, 2)
    assert tabletop["hours"] == round(hours / 1.5, 2)
    assert door["hours"] == door["hours_in_turn"] == round(5 * door["steps"] / 2500 / 3600, 2)
    assert rows[-1]["cells"] == 27
    assert rows[-1]["hours"] == pytest.approx(sum(row["hours"] for row in rows[:-1]))
    assert budget.budget(rates, overhead=0.5)[-1]["hours"] == pytest.approx(2 * rows[-1]["hours"], abs=0.05)
    with pytest.raises(ValueError, match="no rate of one program on sawyer_peg"):
        budget.budget([row for row in rates if row["env"] != "sawyer_peg"])


def test_the_kernels_of_a_step_are_those_of_the_body_of_the_scan():
    def step(x, _):
        return jnp.sin(x @ x), None

    program = jax.jit(lambda x: jnp.cos(jax.lax.scan(step, x, length=5)[0])).lower(jnp.ones((8, 8))).compile()
    found = kernels.step_kernels(program.as_text())
    depths = {kernel.place.rpartition("/")[2]: kernel.depth for kernel in found}
    assert depths["dot_general"] < depths["sin"], "the sine waits for the product"
    assert not any("cos" in kernel.name + kernel.place for kernel in found), "the cosine is outside the loop"


class FakeChunks:
    """A program of benchmarks.speed.method_cost that has one rate after another, and a full replay after the last."""

    def __init__(self, name, *rates):
        self.name, self._rates = name, list(rates)

    def fit(self, seconds):
        assert seconds == 0.7

    def rate(self):
        return self._rates.pop(0)

    @property
    def full(self):
        return not self._rates


def test_the_cost_of_a_method_is_its_rate_beside_naives_in_the_same_round(tmp_path):
    options, out = method_cost.Options(rounds=9, lanes=3), tmp_path / "device"
    naive, rlpd = FakeChunks("naive", 1.0, 1000.0, 2000.0, 4000.0), FakeChunks("rlpd utd=20", 1.0, 100.0, 100.0, 800.0)
    method_cost.measure([naive, rlpd], options, out)
    report = json.loads(out.with_suffix(".json").read_text())
    assert report["rates"] == {"naive": [1000.0, 2000.0, 4000.0], "rlpd utd=20": [100.0, 100.0, 800.0]}
    row = report["rows"][1]
    assert [row[name] for name in ("method", "options", "lanes", "rounds")] == ["rlpd", "utd=20", 3, 3]
    assert [row[name] for name in ("ratio_low", "ratio", "ratio_high", "steps_per_s")] == [0.075, 0.1, 0.15, 100.0]
    file, device = out.with_suffix(".csv"), report["rows"][0]["device"]
    file.write_text(file.read_text().replace(device, "cpu"))
    table = method_cost.tables(tmp_path)
    assert "3 lanes, `precision=bf16`, 3 rounds:" in table
    assert "| `rlpd`, `utd=20` | 0.1 |" in table
    file.write_text(file.read_text().replace("cpu", "NVIDIA H200"))
    assert "| `rlpd`, `utd=20` | 100 | 0.1 |" in method_cost.tables(tmp_path)


def test_the_cost_of_every_method_is_measured():
    for name in method_cost.METHODS:
        algo, *own = name.split()
        make_algo(algo, precision="bf16", **parse_options(tuple(own)))
    assert {name.split()[0] for name in method_cost.METHODS} == set(list_algos())
