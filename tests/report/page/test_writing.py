"""The html page of runs: what it says, that it is safe, and that a browser shows it."""

import base64
import gzip
import hashlib
import html
import html.parser
import json
import re
import shutil
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from earl_jax.algos import make_algo
from earl_jax.cli.report import report
from earl_jax.envs import make
from earl_jax.report.html import media
from earl_jax.report.html.origin import origins
from earl_jax.report.html.runs import find, gather
from earl_jax.report.html.tables import paper_table, seed_table, strips
from earl_jax.report.html.writing import write_page
from earl_jax.runs.config import RunConfig
from earl_jax.runs.folder import RunFolder
from earl_jax.training import api as training
from tests.conftest import tiny_options

pytest.importorskip("jinja2", reason="reports need the extra 'report'")
pytest.importorskip("plotly", reason="reports need the extra 'report'")

TABLETOP, DOOR = "tabletop_organization", "sawyer_door"
EVIL = "</script><script>alert(1)</script><img src=x onerror=alert(2)>"
COUNTS = ("interventions", "faults", "reached")
CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
FLAGS = [
    "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-sync",
    "--disable-background-networking", "--disable-component-update",
]  # fmt: skip


def write_run(
    path, env, algo, deployed, seeds=None, setting=None, env_options=None, planned=None, method_state=(), **options
):
    """Write a run whose seeds score `deployed [N, E]` every 10 steps."""
    scores = np.asarray(deployed, float)
    steps = 10 * np.arange(1, scores.shape[1] + 1)
    one = RunConfig.of(
        make(env, **(env_options or {})), make_algo(algo, **options), seeds or range(len(scores)),
        planned or int(steps[-1]), 10, 2, 10, setting,
    )  # fmt: skip
    folder = RunFolder.create(path, one)
    for number, step in enumerate(steps.tolist()):
        values = dict.fromkeys(("deployed/success", "deployed/return"), scores[:, number])
        values |= {f"continuing/{name}": scores[:, number] / 100 for name in ("reward", "recent")}
        values |= {name: np.full(len(scores), step // 10) for name in (*COUNTS, *method_state)}
        folder.append(folder.config.rows(step, values))
    return path


def rising(seeds, evaluations, top=1.0):
    """Return scores [seeds, evaluations] that rise to `top`, each seed a little lower than the one before."""
    return np.outer(top - 0.1 * np.arange(seeds), np.linspace(0, 1, evaluations))


class Reader(html.parser.HTMLParser):
    """What a browser would load and run, and the text that it would show."""

    def __init__(self, text):
        super().__init__(convert_charrefs=True)
        self.tags, self.links, self.attributes, self.render_state, self.raw = [], [], [], [], {}
        self.inside = ""
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.attributes += [name for name, _ in attrs]
        self.links += [value for name, value in attrs if name in ("src", "href", "srcset", "poster", "action", "data")]
        self.inside = (dict(attrs).get("id") or "own") if tag == "script" else tag

    def handle_endtag(self, tag):
        self.inside = ""

    def handle_data(self, data):
        if self.inside in ("plotly", "numbers", "own", "style"):
            self.raw[self.inside] = self.raw.get(self.inside, "") + data
        else:
            self.render_state.append(data)

    @property
    def text(self):
        return re.sub(r"\s+", " ", " ".join(self.render_state))

    def numbers(self):
        return json.loads(gzip.decompress(base64.b64decode(self.raw["numbers"])))


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    """Two tasks, variants of a method, a run that names itself in html, one cut short, and three that can't be read."""
    root = tmp_path_factory.mktemp("runs")
    write_run(root / "fbrl", TABLETOP, "fbrl", rising(3, 30), method_state=("help/asked",))
    write_run(root / "deep" / "naive1", TABLETOP, "naive", rising(3, 30, 0.5), planned=600)
    write_run(root / "deep" / EVIL.replace("/", "|"), TABLETOP, "naive", rising(2, 30), env_options={"demo_file": EVIL})
    write_run(root / "door", DOOR, "oracle", rising(4, 3))
    config = json.loads((root / "door" / "config.json").read_text())
    config["provenance"]["versions"] = {"jax": EVIL}
    (root / "door" / "config.json").write_text(json.dumps(config))
    for name in ("torn", "young", "alien"):
        write_run(root / name, TABLETOP, "r3l", rising(2, 2))
    (root / "torn" / "config.json").write_text('{"env": ' + EVIL)
    (root / "young" / "metrics.csv").unlink()
    lines = (root / "alien" / "metrics.csv").read_text().splitlines()
    (root / "alien" / "metrics.csv").write_text("\n".join([*lines[:2], "20,0,high"]) + "\n")
    (root / "deep" / "naive1" / "checkpoints").mkdir()
    broken = root / "fbrl" / "checkpoints" / "000000300"
    broken.mkdir(parents=True)
    (broken / "manifest.json").write_text("{}")
    (root / "fbrl" / "video.gif").write_bytes(b"GIF89a" + bytes(20))
    return root


@pytest.fixture(scope="module")
def written(folders):
    visits = np.random.default_rng(0).poisson(0.5, (3, 64, 64))
    real = media.load_lanes

    def load(folder):
        drawn = folder.path.name == "naive1"
        return (make(TABLETOP), None, SimpleNamespace(visits=visits)) if drawn else real(folder)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(media, "load_lanes", load)
        return write_page([folders], folders.parent / "page.html")


@pytest.fixture(scope="module")
def page(written):
    return Reader(written.read_text(encoding="ascii"))


def test_a_page_has_all_its_parts(page):
    assert {"table", "figure", "svg", "button", "details", "img"} <= set(page.tags)
    parts = (
        "Table 1", "Table 2", "How fast", "Where each seed ended", "Numbers of every seed", "What they do",
        "Where they have been", "Runs", "Versions", "Left out", "All settings", "config.json", "Tabletop organization",
        "Sawyer door", "Help asked for",
    )  # fmt: skip
    for part in parts:
        assert part in page.text, part
    assert "earl-jax train tabletop_organization --algo fbrl --seeds 3 --steps 300" in page.text
    assert "300 of 600 steps lived" in page.text
    assert "0.94 (0.04)" in page.text
    assert "No map of fbrl: checkpoint" in page.text


def test_a_page_asks_nothing_of_the_network(page, written):
    assert page.links
    assert [link for link in page.links if not link.startswith(("#", "data:"))] == []
    assert not re.search(r"@import|url\(|https?:", page.raw["style"])
    assert not re.search(r"fetch|XMLHttp|import|https?:|\beval", page.raw["own"])
    policy = html.unescape(re.search(r'Content-Security-Policy" content="([^"]+)"', written.read_text())[1])
    assert policy.startswith("default-src 'none'; script-src 'sha256-")
    allowed = set(re.findall(r"sha256-[^']+", policy))
    scripts = (page.raw["own"].encode(), gzip.decompress(base64.b64decode(page.raw["plotly"])))
    assert allowed == {"sha256-" + base64.b64encode(hashlib.sha256(text).digest()).decode() for text in scripts}


def test_what_runs_say_is_text_and_never_html(page, written):
    assert page.tags.count("script") == 3
    assert page.tags.count("img") == 1
    assert not [name for name in page.attributes if name.startswith("on")]
    assert page.text.count(EVIL) >= 4
    assert EVIL not in written.read_text()


def test_damaged_runs_are_listed_with_their_causes_and_cost_no_other(page, folders):
    start = page.text.index("Left out")
    assert "3 folders could not be read" in page.text
    for name, cause in (("torn", "is damaged"), ("young", "has no evaluation yet"), ("alien", "metrics.csv")):
        assert re.search(rf"{re.escape(str(folders / name))}.*{cause}", page.text[start:])
    lines, left_out = gather(find([folders]))
    assert len(lines) == 4
    assert len(left_out) == 3


def test_nothing_to_show_is_an_error_that_says_why(tmp_path, folders):
    with pytest.raises(ValueError, match=r"none of the runs can be shown:\n.*torn: .*damaged"):
        write_page([folders / "torn"], tmp_path / "a.html")
    with pytest.raises(ValueError, match=r"no config\.json in it or below"):
        write_page([tmp_path], tmp_path / "a.html")
    with pytest.raises(ValueError, match="missing is no folder"):
        write_page([tmp_path / "missing"], tmp_path / "a.html")
    with pytest.raises(ValueError, match="at least one"):
        write_page([], tmp_path / "a.html")
    for name in ("a.htm", "a", "metrics.csv"):
        with pytest.raises(ValueError, match=r"written as an \.html file"):
            write_page([folders], tmp_path / name)
    assert list(tmp_path.iterdir()) == []


def test_plots_have_means_bands_seeds_and_what_was_published(page):
    first = page.numbers()["t0"]
    deployed = first["panels"][0]
    lines = {first["looks"][one["line"]]["label"]: one for one in deployed["lines"]}
    fbrl = lines["fbrl"]
    assert fbrl["x"] == list(range(10, 301, 10))
    assert fbrl["plain"]["mean"][-1] == 0.9
    assert [seed[-1] for seed in fbrl["plain"]["each"]] == [1.0, 0.9, 0.8]
    assert fbrl["plain"]["low"][-1] == pytest.approx(0.8)
    assert fbrl["smooth"]["mean"][-1] == pytest.approx(0.9 * (1 - 4.5 / 29), abs=1e-4)
    assert fbrl["published"]["final"][0] == 0.94
    assert fbrl["published"]["crossings"] == [[860_000, 0.5], [2_070_000, 0.9]]
    assert [label for label, one in lines.items() if one["plain"]["low"] is None] == [f"naive (demo_file={EVIL})"]


def test_tables_have_ours_beside_the_published(folders):
    lines, _ = gather(find([folders]))
    group = paper_table(1, lines)["groups"][0]
    rows = {row["label"]: row for row in group["rows"]}
    assert (rows["fbrl"]["mean"], rows["fbrl"]["lives"], rows["fbrl"]["published"]) == (
        "0.900",
        "3 × 300",
        "0.94 (0.04)",
    )
    assert rows["r3l"]["line"] is None
    assert rows["fbrl"]["age"] == "at 0.012 % of steps"
    ended = strips([line for line in lines if line.cell.label == "fbrl"])["rows"][0]
    assert [dot["text"] for dot in ended["dots"]] == ["seed 2: 0.800", "seed 1: 0.900", "seed 0: 1.000"]
    assert ended["dots"][0]["x"] < ended["dots"][-1]["x"]
    table = seed_table([line for line in lines if line.cell.label == "fbrl"])
    assert table["head"][-1] == "help asked for"
    assert table["rows"][2]["texts"] == ["0.800", "0.676", "0.0080", "30", "30", "30", "30"]


def test_versions_that_differ_are_marked(folders):
    lines, _ = gather(find([folders]))
    told = origins([run for line in lines for run in line.runs])
    assert [head["count"] for head in told["heads"]] == [3, 1]
    assert "jax" in told["differing"]
    assert "python" not in told["differing"]
    assert next(row["values"] for row in told["rows"] if row["name"] == "numpy") == [np.__version__, "unknown"]


def test_a_page_is_replaced_at_once_or_not_at_all(folders, tmp_path, monkeypatch):
    page = tmp_path / "deep" / "page.html"
    assert write_page([folders / "door"], page) == page
    before = page.read_text()
    monkeypatch.setattr(Path, "replace", lambda *_: (_ for _ in ()).throw(OSError(28, "disk full")))
    with pytest.raises(OSError, match="disk full"):
        write_page([folders / "fbrl"], page)
    assert page.read_text() == before
    assert list(page.parent.iterdir()) == [page]


@pytest.fixture
def browser():
    playwright = pytest.importorskip("playwright.sync_api", reason="the browser test needs playwright")
    if CHROMIUM is None:
        pytest.skip("the browser test needs Chromium")
    with playwright.sync_playwright() as started:
        yield started.chromium.launch(executable_path=CHROMIUM, args=FLAGS)


@pytest.mark.slow
def test_a_trained_run_has_a_map_of_where_it_was(tmp_path, capsys):
    options = tiny_options("fbrl")
    training.train(TABLETOP, make_algo("fbrl", **options), seeds=2, steps=80, eval_every=40, out=tmp_path / "run")
    report((tmp_path,), tmp_path / "page.html")
    assert re.fullmatch(r".*page\.html: \d\.\d MB\n", capsys.readouterr().out)
    page = Reader((tmp_path / "page.html").read_text())
    drawn = page.numbers()["t0"]["maps"]
    assert np.sum([share or 0 for row in drawn[0]["shares"] for share in row]) == pytest.approx(1, abs=0.01)


@pytest.mark.slow
def test_a_browser_shows_the_page_without_complaint(browser, written):
    tab = browser.new_page(viewport={"width": 390, "height": 844}, color_scheme="dark")
    told, asked = [], []
    tab.on("console", lambda message: told.append(message.text))
    tab.on("pageerror", lambda error: told.append(str(error)))
    tab.on("request", lambda request: asked.append(request.url))
    tab.goto(written.as_uri())
    tab.wait_for_selector("html[data-ready]", state="attached", timeout=60_000)
    assert tab.locator(".js-plotly-plot .main-svg").count() >= tab.locator(".plot").count() > 6
    assert tab.locator("[data-map] .heatmaplayer image").count() == 1
    deployed = '#t0 [data-panel="0"] g.trace'
    assert tab.locator(f'{deployed}[class*="-mean"] path.js-line').count() == 3
    tab.locator("#t0 .chip").first.click()
    tab.locator('#t0 [data-show="each"]').check()
    assert [tab.locator(f'{deployed}[class*="-{kind}"]').count() for kind in ("mean", "each")] == [2, 2]
    assert not tab.locator(".modebar-btn[data-title*='Share']").count()
    tab.locator("details").evaluate_all("all => all.forEach((one) => { one.open = true; })")
    for width in (390, 1280):
        tab.set_viewport_size({"width": width, "height": 844})
        assert tab.evaluate("document.documentElement.scrollWidth") <= width
    tab.emulate_media(color_scheme="light")
    tab.evaluate("dispatchEvent(new Event('beforeprint')); dispatchEvent(new Event('afterprint'))")
    assert told == []
    assert [url for url in asked if not url.startswith(("data:", "blob:"))] == [written.as_uri()]
