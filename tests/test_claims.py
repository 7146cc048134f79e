"""A measured number of README, docs and examples occurs in a file that its paragraph names.

A measured number has a decimal point, a thousands comma or a percent sign, and stands outside code. Its sources are files below
benchmarks/results that its paragraph (or list, or table) or the first paragraph of its section links to, and the paths in a
comment behind either: `<!-- from benchmarks/results/X.csv tests/test_y.py -->`. Patterns such as `results/*.csv` are allowed.
Tables between marks are left out: tests/test_benchmark_pages.py compares them with the runs.
"""

import functools
import re
from bisect import bisect_left
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.test_docs import PAGES, ROOT

READ = {".csv", ".json", ".jsonl", ".md", ".py", ".xml", ".toml"}
UNITS = {"%": 0.01, "M": 1e6, "k": 1e3, "mm": 1e-3, "cm": 1e-2, "ms": 1e-3, "GB": 1e9, "MB": 1e6, "kB": 1e3}
NUMBER = re.compile(
    r"(?P<below><\s?)?(?<![A-Za-z\d.])(?P<whole>\d{1,3}(?:,\d{3})+(?!\d)|\d+)(?P<part>\.\d+)?(?:e(?P<power>[-+]?\d{1,2})(?!\d))?"
    r"(?:\s?(?P<unit>%|(?:M|k|mm|cm|ms|GB|MB|kB)\b))?"
)
COMMENT, FROM = re.compile(r"<!--.*?-->", re.DOTALL), re.compile(r"<!--\s+from\s+(.*?)-->", re.DOTALL)
NO_CLAIM = re.compile(
    r"`[^`]*`|\$[^$\n]*\$|\]\([^)\s]*\)|https?://\S+|<[a-z/][^>]*>"  # code, formulas, targets of links, tags
    r"|\d{4}-\d\d-\d\d|\d+\.\d+\.\d+\S*|arXiv[ :]\S+|[Ss]ections? [A-Z\d.]+(?: (?:and|to) [A-Z\d.]+)?|\b95 %"
    r"|\b(?:Python|jax|JAX|CUDA|MuJoCo|mujoco|brax|SBX|rejax|gymnasium) \d[\d.]*\d(?: (?:to|or|and) \d\.\d+)?|p under 0\.05",
)
FENCE = re.compile(r"^( *)```.*?^\1```.*?$", re.DOTALL | re.MULTILINE)
WRITTEN = re.compile(r"<!-- (\w+) -->\n.*?<!-- end of \1 -->", re.DOTALL)


@functools.cache
def numbers(source: Path) -> list[float]:
    """Return the absolute values of all numbers in a file, those with a unit also without it, in order."""
    text = source.read_text()
    text = re.sub(r"(?<=\d)_(?=\d)", "", text) if source.suffix == ".py" else text
    text = text if source.suffix in {".md", ".py"} else text.replace(",", " ")
    return sorted({value for match in NUMBER.finditer(text) for value, _ in readings(match)})


def readings(match: re.Match[str]) -> list[tuple[float, float]]:
    """Return what a number may stand for, in its unit and without: the value and half of its last digit."""
    part, power = match["part"] or "", int(match["power"] or 0)
    value = float(f"{match['whole'].replace(',', '')}{part}e{power}")
    half = 0.5000005 * 10.0 ** (power - max(0, len(part) - 1))
    return [(value * scale, half * scale) for scale in {1.0, UNITS.get(match["unit"], 1.0)}]


def occurs(match: re.Match[str], sources: set[Path]) -> bool:
    """Return whether a source has the number at its printed rounding; `<0.001` asks for a smaller one."""
    for values in map(numbers, sources):
        for value, half in readings(match):
            place = bisect_left(values, 0.0 if match["below"] else value - half)
            if place < len(values) and values[place] <= value + half:
                return True
    return False


def paragraphs(text: str) -> Iterator[tuple[int, int, str, str]]:
    """Yield line, level of a heading just above (0 without one), text, and named sources of every paragraph."""
    for left_out in (WRITTEN, FENCE):
        text = left_out.sub(lambda match: re.sub(r"[^\n]+", "<!-- -->", match[0]), text)
    text = re.sub(r"^$(?=\n<!--)", "<!-- -->", text, flags=re.MULTILINE)  # a comment belongs to the paragraph before it
    level = 1
    for match in re.finditer(r"(?:[^\n]*\S[^\n]*\n?)+", text):
        for heading in re.findall(r"^(#+) ", match[0], flags=re.MULTILINE):
            level = len(heading)
        prose = re.sub(r"^#+ .*$", "", COMMENT.sub("", match[0]), flags=re.MULTILINE)
        if prose.strip():
            yield text.count("\n", 0, match.start()) + 1, level, prose, " ".join(FROM.findall(match[0]))
            level = 0


def faults(page: Path) -> list[str]:
    """Return the numbers of a page that no named source has, and the sources that do not exist."""
    wrong: list[str] = []
    above: dict[int, set[Path]] = {}
    for line, level, prose, names in paragraphs(page.read_text()):
        links = {(page.parent / link.partition("#")[0]).resolve() for link in re.findall(r"\]\(([^)\s]+)\)", prose)}
        files = {link for link in links if link.is_relative_to(ROOT / "benchmarks/results") and link.is_file()}
        files |= {file for name in names.split() for file in ROOT.glob(name)}
        files = {file for file in files if file.suffix in READ and file.name != "README.md"}
        if level:
            above = {depth: files for depth, files in above.items() if 1 < depth < level} | {level: files}
        sources = files.union(*above.values())
        wrong += [f"line {line}: there is no {name}" for name in names.split() if not list(ROOT.glob(name))]
        for match in NUMBER.finditer(NO_CLAIM.sub(" ", prose)):
            measured = match["part"] or match["unit"] == "%" or "," in match["whole"]
            if measured and not occurs(match, sources):
                named = ", ".join(sorted(source.name for source in sources)) or "no source is named"
                wrong.append(f"line {line}: {match[0].strip()} ({named})")
    return wrong


@pytest.mark.parametrize(
    "page", [page for page in PAGES if page.suffix == ".md"], ids=lambda page: page.relative_to(ROOT).as_posix()
)
def test_every_measured_number_is_in_a_named_source(page):
    assert faults(page) == []


def test_every_marked_table_has_a_module_that_writes_it():
    modules = "".join(path.read_text() for path in (ROOT / "benchmarks").rglob("*.py"))
    marks = {name for page in PAGES for name in WRITTEN.findall(page.read_text())}
    assert {name for name in marks if f'"{name}"' not in modules} == set()


SOURCE = "benchmarks/results/fifty/fifty.json"  # success 0.758, standard error 0.035, 500,000 steps
NONE = "no source is named"


@pytest.mark.parametrize(
    ("text", "wrong"),
    [
        (f"A mean of 0.758 after 0.50M steps.\n<!-- from {SOURCE} -->", []),
        (f"It is 75.8 %, or 0.76.\n\n<!-- from\n{SOURCE} -->", []),
        (f"[Fifty]({ROOT / SOURCE}): 0.758.\n\n- After 500,000 steps: 0.758, p <0.05.\n\n```\n0.999\n```", []),
        (f"## A\n\n0.758\n<!-- from {SOURCE} -->\n\n### B\n\n| x |\n| --- |\n| 0.758 |", []),
        ("On 2026-11-22 with jax 0.11.2, `0.999` and 95 % intervals (Section 4.1), 3M steps.", []),
        (f"It is 0.757.\n<!-- from {SOURCE} -->", ["line 1: 0.757 (fifty.json)"]),
        (f"It is 0.758.\n<!-- from {SOURCE} -->\n\n## B\n\nIt is 0.758.", [f"line 6: 0.758 ({NONE})"]),
        ("There are 500,001.\n<!-- from no.csv -->", ["line 1: there is no no.csv", f"line 1: 500,001 ({NONE})"]),
    ],
)
def test_a_claim_without_a_source_is_found(tmp_path, text, wrong):
    page = tmp_path / "page.md"
    page.write_text(text)
    assert faults(page) == wrong
