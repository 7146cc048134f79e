"""A browser shows the page: every plot is drawn, and nothing is loaded from elsewhere."""

import shutil

import pytest

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
FLAGS = [
    "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-sync",
    "--disable-background-networking", "--disable-component-update",
]  # fmt: skip


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
    for width in (390, 1280):
        tab.set_viewport_size({"width": width, "height": 844})
        assert tab.evaluate("document.documentElement.scrollWidth") <= width
    tab.emulate_media(color_scheme="light")
    tab.evaluate("dispatchEvent(new Event('beforeprint')); dispatchEvent(new Event('afterprint'))")
    assert messages == []
    assert [url for url in requests if not url.startswith(("data:", "blob:"))] == [written.as_uri()]
