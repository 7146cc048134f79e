"""The snippets of docs/adapters.md run without changes."""

import importlib.util
import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.adapters.test_brax import NEEDS

PAGE = (Path(__file__).parents[2] / "docs" / "adapters.md").read_text()
SNIPPETS = re.findall(r"```python\n(.*?)```", PAGE, flags=re.DOTALL)


@pytest.mark.slow
@pytest.mark.parametrize("number", range(len(SNIPPETS)))
def test_a_snippet_runs(number, capsys):
    if "stable_baselines3" in SNIPPETS[number]:
        if not importlib.util.find_spec("stable_baselines3"):
            pytest.skip("pip install 'earl-jax[peers]'")
        subprocess.run(
            [sys.executable, "-c", SNIPPETS[number]], check=True
        )  # a process of its own, as in sb3_trains.py
        return
    exec(compile(SNIPPETS[number], "docs/adapters.md", "exec"), {"__name__": "snippet"})
    assert capsys.readouterr().out


def test_the_page_lists_the_versions_that_braxs_trainers_are_tested_with():
    assert f"old/bin/pip install {' '.join(NEEDS)}\n" in PAGE
