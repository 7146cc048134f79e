"""Notebooks: made of the scripts in notebooks/ with or without outputs, and turned into pages of the site.

python -m docs.site.notebooks            # writes the .ipynb of every .py; outputs of unchanged notebooks stay
python -m docs.site.notebooks --execute  # runs them too, for about 35 minutes on two quiet CPU cores

Where pyproject.toml has the real address of the repository, notebooks get a button for Colab and a cell that installs the
package from there.
"""

import argparse
import base64
import json
import re
import tomllib
from pathlib import Path
from typing import Any

FOLDER = Path(__file__).resolve().parents[2] / "notebooks"
COLAB = "https://colab.research.google.com"
INSTALL = """import importlib.util

if importlib.util.find_spec("earl_jax") is None:  # a fresh machine, such as Colab's
    %pip install --quiet "earl-jax{extras} @ git+{address}"
"""
TEXT_LINES = 60
"""Lines of printed output that a page shows."""


def page(notebook: dict[str, Any], name: str) -> tuple[str, dict[str, bytes]]:
    """Return a notebook as Markdown, and its pictures by file name."""
    parts, pictures = [], {}
    for cell in notebook["cells"]:
        source = "".join(cell["source"]).strip()
        if not source:
            continue
        if cell["cell_type"] == "markdown":
            parts.append(source)
            continue
        parts.append(f"```python\n{source}\n```")
        for output in cell.get("outputs", []):
            parts.append(_output(output, name, pictures))
    return "\n\n".join(part for part in parts if part) + "\n", pictures


def _output(output: dict[str, Any], name: str, pictures: dict[str, bytes]) -> str:
    """Return an output as Markdown; a picture is added to `pictures`."""
    data = output.get("data", {})
    if "image/png" in data:
        file = f"{name}_{len(pictures) + 1}.png"
        pictures[file] = base64.b64decode("".join(data["image/png"]))
        return f"![output of the cell above]({file})"
    if "text/markdown" in data:
        return "".join(data["text/markdown"])
    if output.get("name") == "stderr":
        return ""
    lines = "".join(output.get("text", data.get("text/plain", ""))).rstrip().splitlines()
    shown = [*lines[:TEXT_LINES], "..."] if len(lines) > TEXT_LINES else lines
    return "```text\n" + "\n".join(shown) + "\n```" if shown else ""


def index(folder: Path) -> str:
    """Return the page that lists the notebooks of `folder`."""
    lines = ["# Notebooks", "", "Each page is a script and a notebook in `notebooks/`.", ""]
    for path in sorted(folder.glob("*.ipynb")):
        title = "".join(json.loads(path.read_text())["cells"][0]["source"]).splitlines()[0].strip("# ")
        lines.append(f"- [{title}]({path.stem}.ipynb)")
    return "\n".join(lines) + "\n"


def repository() -> str:
    """Return the address of the repository in pyproject.toml, or an empty text while its owner is one in capitals."""
    project = tomllib.loads((FOLDER.parent / "pyproject.toml").read_text())["project"]
    address = project["urls"]["Repository"]
    return "" if address.split("/")[3].isupper() else address


def convert(path: Path, address: str | None = None) -> dict[str, Any]:
    """Return the script at `path` as a notebook without outputs, with a button for Colab if `address` is not empty."""
    import jupytext
    import nbformat

    notebook, address = jupytext.read(path), repository() if address is None else address
    if address:
        first = notebook.cells[0].source
        page = f"{COLAB}/github/{address.removeprefix('https://github.com/')}/blob/main/notebooks/{path.stem}.ipynb"
        notebook.cells[0].source = f"{first}\n\n[![Open in Colab]({COLAB}/assets/colab-badge.svg)]({page})"
        extras = re.findall(r"pip install -e '\.(\[.*?\])'", first)[0]
        install = INSTALL.format(extras=extras, address=address)
        notebook.cells.insert(1, nbformat.v4.new_code_cell(install, metadata={"tags": ["install"]}))
    for number, cell in enumerate(notebook.cells):
        cell["id"] = f"cell-{number}"
    notebook.metadata.pop("jupytext", None)
    return json.loads(nbformat.writes(notebook))


def same_source(notebook: dict[str, Any], other: dict[str, Any]) -> bool:
    """Return whether two notebooks have the same cells, outputs aside."""
    cells = [[(cell["cell_type"], "".join(cell["source"])) for cell in book["cells"]] for book in (notebook, other)]
    return cells[0] == cells[1]


def with_outputs(notebook: dict[str, Any], kept: dict[str, Any]) -> dict[str, Any]:
    """Return `notebook` with the outputs of `kept` if both have the same code, apart from cells that install."""
    cells, others = (
        [
            cell
            for cell in book["cells"]
            if cell["cell_type"] == "code" and "install" not in cell["metadata"].get("tags", ())
        ]
        for book in (notebook, kept)
    )
    if ["".join(cell["source"]) for cell in cells] == ["".join(cell["source"]) for cell in others]:
        for cell, other in zip(cells, others, strict=True):
            cell |= {"outputs": other["outputs"], "execution_count": other["execution_count"]}
    return notebook


def execute(notebook: dict[str, Any]) -> dict[str, Any]:
    """Return the notebook with the outputs of a run from top to bottom in a folder of its own."""
    import tempfile

    import nbclient
    import nbformat

    book = nbformat.reads(json.dumps(notebook), 4)
    with tempfile.TemporaryDirectory() as folder:
        nbclient.NotebookClient(book, timeout=None, resources={"metadata": {"path": folder}}).execute()
    for cell in book.cells:
        cell.metadata.pop("execution", None)  # times
    return json.loads(nbformat.writes(book))


def main() -> None:
    """Write the notebooks."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--execute", action="store_true")
    parser.add_argument("names", nargs="*", help="notebooks, by default all")
    arguments = parser.parse_args()
    for path in sorted(FOLDER.glob("*.py")):
        if arguments.names and path.stem not in arguments.names:
            continue
        notebook, target = convert(path), path.with_suffix(".ipynb")
        kept = json.loads(target.read_text()) if target.exists() else None
        if arguments.execute:
            notebook = execute(notebook)
        elif kept and same_source(notebook, kept):
            continue
        elif kept:
            notebook = with_outputs(notebook, kept)
        target.write_text(json.dumps(notebook, indent=1, ensure_ascii=False) + "\n")
        print(target)


if __name__ == "__main__":
    main()
