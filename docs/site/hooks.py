"""What MkDocs does not do by itself: pages from outside docs/, links to them, notebooks, and formulas as MathML.

The pages of docs/ are written to be read in the repository, where links go to files. On the site a link to a file that is no
page goes to the repository, whose address is `repo_url` of mkdocs.yml or that of pyproject.toml, or is plain text without
one.
"""

import html
import json
import logging
import posixpath
import re
from pathlib import Path
from typing import Any

from docs.site import notebooks

ROOT = Path(__file__).resolve().parents[2]
LINK = re.compile(r"(!?\[(?:[^\]\[]|\[[^\]]*\]\([^)]*\))*\])\(([^)\s]+)\)")
FENCE = re.compile(r"(^```.*?^```$)", re.MULTILINE | re.DOTALL)
FORMULA = re.compile(r'<(span|div) class="arithmatex">\\[(\[](.*?)\\[)\]]</\1>', re.DOTALL)
CELL = re.compile(r"<t[dh]\b.*?</t[dh]>", re.DOTALL)
INTERVAL = re.compile(r"\[[^\s\]<]+ [^\s\]<]+\]")
UNKNOWN_COMMANDS = {r"\arg": r"\operatorname{arg}", r"\big\|": r"\|"}
"""Commands that the converter of formulas does not know, and what it knows in their place."""
OUTSIDE = {"CHANGELOG.md": "changelog.md", "examples/cfbrl/README.md": "cfbrl.md"}
"""Pages outside docs/ that have a place in the navigation, with their paths on the site."""
PICTURES = (".png", ".webp", ".gif", ".svg")
log = logging.getLogger("mkdocs.hooks.earl_jax")


def on_files(files: Any, config: Any) -> Any:
    """Add the notebooks, the pages `OUTSIDE`, and what pages link to outside docs/: pictures and pages."""
    from mkdocs.structure.files import File

    for path in sorted((ROOT / "notebooks").glob("*.ipynb")):
        text, pictures = notebooks.page(json.loads(path.read_text()), path.stem)
        files.append(File.generated(config, f"notebooks/{path.stem}.md", content=text))
        for name, data in pictures.items():
            files.append(File.generated(config, f"notebooks/{name}", content=data))
    files.append(File.generated(config, "notebooks/index.md", content=notebooks.index(ROOT / "notebooks")))
    for source in [*OUTSIDE, *outside_files(ROOT / "docs")]:
        files.append(File.generated(config, site_path(source), abs_src_path=str(ROOT / source)))
    return files


def outside_files(folder: Path) -> list[str]:
    """Return the pages and pictures of benchmarks/ that the pages of `folder` and `OUTSIDE` link to, as repository paths."""
    targets = set()
    for page in [*folder.rglob("*.md"), *(ROOT / source for source in OUTSIDE)]:
        base = page.parent.relative_to(ROOT).as_posix()
        for _, target in LINK.findall(page.read_text()):
            source = posixpath.normpath(posixpath.join(base, target.partition("#")[0]))
            if source.startswith("benchmarks/") and source.endswith((".md", *PICTURES)):
                targets.add(source)
    return sorted(targets)


def site_path(source: str) -> str | None:
    """Return the path on the site of the file `source` of the repository, or None if it is not on the site."""
    if source in OUTSIDE:
        return OUTSIDE[source]
    if source.startswith("docs/"):
        return source.removeprefix("docs/")
    if source.rstrip("/") == "notebooks":
        return "notebooks/index.md"
    if source.startswith("notebooks/"):
        return str(Path(source).with_suffix(".md"))
    return source if source in outside_files(ROOT / "docs") else None


def repository_path(page: str) -> str:
    """Return the path in the repository of the page `page` of the site."""
    sources = {path: source for source, path in OUTSIDE.items()}
    if page in sources:
        return sources[page]
    return page if page.startswith(("notebooks/", "benchmarks/")) else f"docs/{page}"


def linked(label: str, target: str, page: str, repository: str) -> str:
    """Return the link of `page` to `target` as it is on the site; the `repository` is an address or empty."""
    if target.startswith(("http", "#", "mailto:")):
        return f"{label}({target})"
    path, hash_, anchor = target.partition("#")
    source = posixpath.normpath(posixpath.join(posixpath.dirname(repository_path(page)), path))
    if source.startswith("notebooks/") and source.endswith(PICTURES):
        return f"{label}({target})"
    found = site_path(source)
    if found is not None:
        return f"{label}({posixpath.relpath(found, posixpath.dirname(page) or '.')}{hash_}{anchor})"
    return f"{label}({repository}/blob/main/{source}{hash_}{anchor})" if repository else label.strip("![]")


def on_page_markdown(markdown: str, *, page: Any, config: Any, files: Any) -> str:
    """Rewrite the links outside of code."""
    repository = (config.repo_url or notebooks.repository()).rstrip("/")
    name = page.file.src_uri
    parts = FENCE.split(markdown)
    for index in range(0, len(parts), 2):
        parts[index] = LINK.sub(lambda match: linked(match[1], match[2], name, repository), parts[index])
    return "".join(parts)


def on_page_content(content: str, *, page: Any, config: Any, files: Any) -> str:
    """Replace formulas by MathML, which needs no script, and keep the ends of an interval in a table on one line."""
    import latex2mathml.converter

    def mathml(match: re.Match[str]) -> str:
        display = "block" if match[1] == "div" else "inline"
        source = html.unescape(match[2])
        for command, known in UNKNOWN_COMMANDS.items():
            source = source.replace(command, known)
        formula = latex2mathml.converter.convert(source, display=display)
        if ">\\" in formula:  # a command that the converter does not know; a warning ends a strict build
            log.warning("%s: the formula %s is not understood", page.file.src_uri, match[2])
        return f'<div class="formula">{formula}</div>' if match[1] == "div" else formula

    def unbroken(cell: re.Match[str]) -> str:
        return INTERVAL.sub(lambda interval: interval[0].replace(" ", "&nbsp;"), cell[0])

    return CELL.sub(unbroken, FORMULA.sub(mathml, content))
