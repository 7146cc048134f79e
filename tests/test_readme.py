"""Tests of the README: its method trains, and its first lines name both commands."""

import re
from pathlib import Path

from earl_jax import algos
from earl_jax.training import train
from tests.conftest import TINY

README = Path(__file__).parents[1] / "README.md"


def test_method_of_the_readme_trains(monkeypatch):
    monkeypatch.setattr(algos._ALGOS, "_table", dict(algos._ALGOS._table))
    blocks = re.findall(r"```python\n(.*?)```", README.read_text(), flags=re.DOTALL)
    source = next(block for block in blocks if "register_algo" in block)
    exec(compile(source, str(README), "exec"), {})
    assert "there_and_back" in algos.list_algos()
    result = train("tabletop_organization", "there_and_back", seeds=2, steps=40, eval_every=40, eval_episodes=1, **TINY)
    assert result.metrics["deployed/success"].shape == (2, 1)
    assert int(result.train_state.replay.counts[0, 1]) == 0


def test_first_lines_name_both_commands():
    top = README.read_text()[:1200]
    assert "make quickstart" in top
    assert "make test" in top
