"""The snippets of docs/adapters.md run as they stand there."""

import re
from pathlib import Path

import pytest

from tests.adapters.test_brax import NEEDS

PAGE = (Path(__file__).parents[2] / "docs" / "adapters.md").read_text()
SNIPPETS = re.findall(r"```python\n(.*?)```", PAGE, flags=re.DOTALL)


@pytest.mark.slow
@pytest.mark.parametrize("number", range(len(SNIPPETS)))
def test_a_snippet_runs(number, capsys):
    if "stable_baselines3" in SNIPPETS[number]:
        pytest.importorskip("stable_baselines3", reason="pip install 'earl-jax[peers]'")
    exec(compile(SNIPPETS[number], "docs/adapters.md", "exec"), {"__name__": "snippet"})
    assert capsys.readouterr().out


def test_the_page_names_what_braxs_trainers_are_tested_with():
    assert f"old/bin/pip install {' '.join(NEEDS)}\n" in PAGE
