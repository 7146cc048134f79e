"""A browser shows the page: every plot is drawn, and nothing is loaded from elsewhere."""

import shutil

import numpy as np
import pytest

from earl_jax.metrics.phase_stats import FORWARD
from tests.attacks.test_reports import HOSTILE, write_labelled
from tests.report.run_files import rising, write_page_run

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
FLAGS = [
    "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-sync",
    "--disable-background-networking", "--disable-component-update",
]  # fmt: skip

CUT_TABLES = """() => [...document.querySelectorAll("table")].filter((table) => {
  const box = table.closest(".scroll"), [first] = table.querySelectorAll("tbody th"), last = table.querySelector("td:last-child");
  box.scrollLeft = box.scrollWidth;  // scrolls to the end, where the first column stays in view
  const edges = [box, first, last].map((part) => part.getBoundingClientRect());
  const seen = edges[0].left >= 0 && edges[0].right <= innerWidth && getComputedStyle(box).overflowX === "auto";
  return !(seen && Math.abs(edges[1].left - edges[0].left) < 1 && Math.abs(edges[2].right - edges[0].right) < 1);
}).length"""
"""The number of tables that leave the window, or do not scroll to their last column beside the first one."""
HOVER_TEXTS = """async () => {
  const plot = document.querySelector(".plot"), texts = [];
  for (const [number, trace] of plot.data.entries()) {
    if (trace.hoverinfo === "skip") continue;
    Plotly.Fx.hover(plot, [{ curveNumber: number, pointNumber: 0 }]);
    await new Promise((next) => setTimeout(next, 100));  // it ignores calls that follow too soon
    texts.push(plot.querySelector(".hoverlayer").textContent);
  }
  return texts;
}"""
"""The texts that a plot shows of its lines under the mouse."""


@pytest.fixture
def browser():
    playwright = pytest.importorskip("playwright.sync_api", reason="the browser test needs playwright")
    if CHROMIUM is None:
        pytest.skip("the browser test needs Chromium")
    with playwright.sync_playwright() as started:
        yield started.chromium.launch(executable_path=CHROMIUM, args=FLAGS)


@pytest.mark.slow
def test_a_browser_shows_the_page_without_errors(browser, written):
    tab = browser.new_page(viewport={"width": 390, "height": 844}, color_scheme="dark")
    messages, requests = [], []
    tab.on("console", lambda message: messages.append(message.text))
    tab.on("pageerror", lambda error: messages.append(str(error)))
    tab.on("request", lambda request: requests.append(request.url))
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
    tab.locator("details").evaluate_all("all => all.forEach((details) => { details.open = true; })")
    assert tab.evaluate("document.querySelector('figure, table').querySelectorAll('[data-panel]').length") == 1
    for width in (390, 1280, 1920):
        tab.set_viewport_size({"width": width, "height": 844})
        assert tab.evaluate("document.documentElement.scrollWidth") <= width
        assert tab.evaluate(CUT_TABLES) == 0
    tab.emulate_media(color_scheme="light")
    tab.evaluate("dispatchEvent(new Event('beforeprint')); dispatchEvent(new Event('afterprint'))")
    assert messages == []
    assert [url for url in requests if not url.startswith(("data:", "blob:"))] == [written.as_uri()]


@pytest.mark.slow
@pytest.mark.parametrize(("evaluations", "panel"), [(1, 0), (5, 2)])
def test_a_browser_draws_an_evaluation_without_neighbours(browser, tmp_path, evaluations, panel):
    from earl_jax.report.html.writing import write_page

    shares = np.array([[np.nan, 0.8, np.nan, 0.1, 0.2]] * 2)[:, :evaluations]
    write_page_run(tmp_path / "run", "fbrl", rising(2, evaluations), metrics={FORWARD: shares})
    tab = browser.new_page()
    tab.goto(write_page([tmp_path / "run"], tmp_path / "page.html").as_uri())
    tab.wait_for_selector("html[data-ready]", state="attached", timeout=60_000)
    tab.locator("details").evaluate_all("all => all.forEach((details) => { details.open = true; })")
    tab.locator('#t0 [data-show="each"]').check()
    drawn = f'#t0 [data-panel="{panel}"] g.trace[class*="-%s"] path.point:not([d^="M0,"])'
    assert [tab.locator(drawn % kind).count() for kind in ("mean", "each")] == [1, 2]


@pytest.mark.slow
def test_hostile_texts_are_text_in_a_browser(browser, tmp_path):
    from earl_jax.report.html.writing import write_page

    page = write_page(write_labelled(tmp_path), tmp_path / "page.html")
    tab, events = browser.new_page(), []
    for name in ("console", "pageerror", "dialog", "popup"):
        tab.on(name, lambda event: events.append(event))
    tab.on("request", lambda request: events.append(request.url))
    tab.goto(page.as_uri())
    tab.wait_for_selector("html[data-ready]", state="attached", timeout=60_000)
    shown = tab.evaluate("document.body.textContent"), "".join(tab.evaluate(HOVER_TEXTS))
    assert events == [page.as_uri()]
    for text in HOSTILE:
        printed = "".join(letter if letter.isprintable() else repr(letter)[1:-1] for letter in f"(demo_file={text})")
        assert printed in shown[0]
        assert "".join(printed.split()) in "".join(shown[1].split())
