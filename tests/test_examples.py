"""The examples of training loops of one's own: they run under the protocol, learn, and are those of the page."""

import json
import re
import runpy
from pathlib import Path

import jax
import numpy as np
import pytest

from earl_jax.envs import make
from earl_jax.protocol import Protocol
from tests.cli.process import run_code
from tests.conftest import assert_all_finite, without_shares

ROOT = Path(__file__).parents[1]
EXAMPLES = ROOT / "examples"
PAGE = (ROOT / "docs" / "custom_loops.md").read_text()
WINDOWS = 2
LEARNS = """
import json, sys
import jax, numpy
sys.path.insert(0, "examples")
import ppo, earl_jax
env = earl_jax.make("tabletop_organization", reward_type="dense", train_horizon=1000)
protocol = earl_jax.Deployment().protocol(env, eval_every=10_000)
lives = jax.jit(jax.vmap(lambda key: ppo.live(env, protocol, key, windows=10)))
metrics = lives(jax.random.split(jax.random.key(1), 5))
print(json.dumps({name: numpy.asarray(metrics[name]).tolist() for name in ("deployed/return", "continuing/recent")}))
"""


@pytest.mark.parametrize(("name", "options"), [("random_agent", {}), ("ppo", {"rollout": 20})])
def test_an_example_lives_under_the_protocol_and_reports_both_scores(name, options):
    env, protocol = make("tabletop_organization", reward_type="dense"), Protocol(20, 5, eval_every=40, eval_episodes=2)
    example = runpy.run_path(str(EXAMPLES / f"{name}.py"))
    live = jax.jit(lambda key: example["live"](env, protocol, key, WINDOWS, **options))
    assert "lapack" not in live.lower(jax.random.key(0)).as_text(), "batched factorisations can hang on two cores"
    metrics = jax.device_get(live(jax.random.key(0)))
    assert_all_finite(without_shares(metrics))
    np.testing.assert_array_equal(metrics["interventions"], [2, 4])
    recent, reward = metrics["continuing/recent"], metrics["continuing/reward"]
    assert reward[1] == pytest.approx(recent.mean())
    assert recent[0] != recent[1]
    assert metrics["deployed/return"].shape == (WINDOWS,)


@pytest.mark.slow
def test_ppo_learns():
    """Over five lives, the mean of the last three evaluations is well above that of the first."""
    metrics = {name: np.array(values) for name, values in json.loads(run_code(LEARNS, XLA_FLAGS="")).items()}
    rises = metrics["deployed/return"][:, -3:].mean(axis=1) - metrics["deployed/return"][:, 0]
    assert rises.mean() > 150
    assert (rises > 0).sum() >= 4
    assert (metrics["continuing/recent"][:, -1] > metrics["continuing/recent"][:, 0] + 1).all()


def test_the_page_has_the_code_of_the_examples():
    blocks = re.findall(r"```python\n(.*?)```", PAGE, flags=re.DOTALL)
    sources = [path.read_text() for path in sorted(EXAMPLES.glob("*.py"))]
    assert blocks
    assert [block for block in blocks if not any(block in source for source in sources)] == []
    assert all(f"../examples/{path.name}" in PAGE for path in EXAMPLES.glob("*.py"))
