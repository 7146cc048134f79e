"""The notebooks: converted to ipynb and pages of the site, and executed in a kernel, at tiny horizons."""

import json
import os
import re
from pathlib import Path

import pytest

from docs.site import notebooks
from tests.conftest import CACHE

NOTEBOOKS = sorted((Path(__file__).parents[1] / "notebooks").glob("*.py"))
EVERY_NOTEBOOK = pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
PICTURES = {
    "01_train_five_seeds": 3, "02_compare_two_methods": 3, "03_write_a_method": 1, "04_run_on_a_gpu": 3,
    "05_mjx_in_one_program": 2,
}  # fmt: skip


@EVERY_NOTEBOOK
def test_a_notebook_is_its_script(path):
    pytest.importorskip("jupytext", reason="notebooks need the extra notebook")
    stored = json.loads(path.with_suffix(".ipynb").read_text())
    assert notebooks.same_source(notebooks.convert(path), stored), "run python -m docs.site.notebooks"


@EVERY_NOTEBOOK
def test_constants_that_the_text_of_a_notebook_names_are_in_its_code(path):
    cells = json.loads(path.with_suffix(".ipynb").read_text())["cells"]
    text, code = (
        "".join("".join(cell["source"]) for cell in cells if cell["cell_type"] == kind) for kind in ("markdown", "code")
    )
    assert [name for name in re.findall(r"`([A-Z_]{2,})`", text) if not re.search(rf"\b{name}\b", code)] == []


def test_a_notebook_becomes_a_page_with_its_outputs():
    outputs = [
        {"output_type": "stream", "name": "stdout", "text": ["a\n", "b\n"]},
        {"output_type": "stream", "name": "stderr", "text": ["noise\n"]},
        {"output_type": "display_data", "data": {"image/png": "iVBORw==", "text/plain": "<Figure>"}},
        {"output_type": "execute_result", "data": {"text/plain": "3"}},
    ]
    cells = [
        {"cell_type": "markdown", "source": ["# Title\n", "text"]},
        {"cell_type": "code", "source": "f()", "outputs": outputs},
    ]
    text, pictures = notebooks.page({"cells": cells}, "nine")
    code = "```python\nf()\n```\n\n```text\na\nb\n```"
    assert text == f"# Title\ntext\n\n{code}\n\n![output of the cell above](nine_1.png)\n\n```text\n3\n```\n"
    assert pictures == {"nine_1.png": b"\x89PNG"}


def test_a_known_repository_gives_a_button_for_colab_and_a_cell_that_installs_and_outputs_stay():
    pytest.importorskip("jupytext", reason="notebooks need the extra notebook")
    [path] = [path for path in NOTEBOOKS if path.stem == "04_run_on_a_gpu"]
    named = notebooks.convert(path, "https://github.com/me/mine")
    first, install = ("".join(cell["source"]) for cell in named["cells"][:2])
    assert first.endswith(
        "(https://colab.research.google.com/github/me/mine/blob/main/notebooks/04_run_on_a_gpu.ipynb)"
    )
    assert '"earl-jax[cuda,notebook] @ git+https://github.com/me/mine"' in install
    kept = json.loads(path.with_suffix(".ipynb").read_text())
    outputs = [cell["outputs"] for cell in kept["cells"] if cell["cell_type"] == "code"]
    moved = notebooks.with_outputs(named, kept)
    assert [cell["outputs"] for cell in moved["cells"] if cell["cell_type"] == "code"] == [[], *outputs]
    next(cell for cell in kept["cells"] if cell["cell_type"] == "code")["source"] = "changed"
    changed = notebooks.with_outputs(notebooks.convert(path, ""), kept)
    assert not any(cell.get("outputs") for cell in changed["cells"])


@pytest.mark.slow
@EVERY_NOTEBOOK
def test_a_notebook_runs_from_top_to_bottom(path, tmp_path, monkeypatch):
    jupytext = pytest.importorskip("jupytext", reason="notebooks need the extra notebook")
    nbclient = pytest.importorskip("nbclient", reason="notebooks are executed by nbclient")
    monkeypatch.setenv("EARL_JAX_NOTEBOOK", "tiny")
    monkeypatch.setenv("TMPDIR", str(tmp_path / "temporary"))
    monkeypatch.setenv("JAX_COMPILATION_CACHE_DIR", str(CACHE))
    monkeypatch.setenv("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0.2")
    for name in ("temporary", "here"):
        (tmp_path / name).mkdir()
    notebook = jupytext.read(path)
    resources = {"metadata": {"path": str(tmp_path / "here")}}
    nbclient.NotebookClient(notebook, timeout=300, kernel_name="python3", resources=resources).execute()
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", [])]
    pictures = [output for output in outputs if "image/png" in output.get("data", {})]
    assert len(pictures) == PICTURES[path.stem]
    assert not os.listdir(tmp_path / "here"), "a notebook writes into its temporary folder alone"
    assert list((tmp_path / "temporary").glob("earl_jax-*/*/metrics.csv"))
