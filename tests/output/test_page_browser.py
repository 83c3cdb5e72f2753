"""The page in a real browser: no errors, complete, animated, legible in a narrow and in a dark window."""

from __future__ import annotations

import json

import numpy as np
import pytest

from tests.support.browser import HOSTILE, Browser

pytestmark = pytest.mark.browser

MOTION = "[data-plot='motion-0']"


@pytest.fixture(scope="module")
def page(browser, study) -> Browser:
    """The study's page with every open view drawn."""
    browser.open(study / "report.html", 900, 640)
    drawings = "[...document.querySelectorAll('details[open] [data-plot]')]"
    for name in browser.js(f"{drawings}.map(e => e.dataset.plot)"):
        browser.show(f"[data-plot='{name}']")
    return browser


def text(browser: Browser, selector: str) -> str:
    return browser.js(f"document.querySelector({json.dumps(selector)}).textContent")


@pytest.mark.long
@pytest.mark.evidence("report", "validated", "Chromium: no error, no request, every view drawn")
def test_the_page_prints_no_error_and_requests_nothing(page):
    assert page.complaints() == []
    assert [url for url in page.requests() if not url.startswith(("file:", "data:", "blob:"))] == []
    drawn = "[...document.querySelectorAll('details[open] [data-plot]')].every(e => e.dataset.drawn === 'yes')"
    assert page.js(drawn)


@pytest.mark.long
def test_entries_on_the_page_can_be_filtered(page, study):
    summary = json.loads((study / "summary.json").read_text("utf-8"))
    labels = page.js(
        "[...document.querySelectorAll('button[data-filter]')].map(b => [b.dataset.filter, b.textContent])"
    )
    total = 0
    for key, label in labels[1:]:
        page.js(f"document.querySelector(\"button[data-filter='{key}']\").click()")
        shown = page.js("document.querySelectorAll('tr[data-row]:not([hidden])').length")
        assert label.endswith(f"({shown})") and text(page, "#row-count") == f"{shown} rows"
        total += shown
    assert labels[0] == ["", "all"] and total == len(summary["figures"])
    page.js("document.querySelector(\"button[data-filter='differs']\").click()")
    shown = "[...document.querySelectorAll('tr[data-row]:not([hidden])')]"
    rows = page.js(f"{shown}.map(r => r.dataset.row)")
    assert set(rows) == {r["id"] for r in summary["figures"] if r["agrees"] is False} != set()
    page.js("document.querySelector(\"button[data-filter='']\").click()")


@pytest.mark.long
@pytest.mark.parametrize(("width", "dark"), [(400, True), (400, False), (1300, True)])
def test_the_page_is_legible_in_a_narrow_and_a_dark_window(browser, study, width, dark):
    browser.open(study / "report.html", width, 400, dark)
    browser.show(MOTION)
    assert browser.js("document.documentElement.scrollWidth <= innerWidth")
    paper = browser.js("getComputedStyle(document.body).backgroundColor")
    light = sum(int(x) for x in paper[4:-1].split(",")[:3]) / 3
    assert light < 60 if dark else light > 230
    ink = browser.js(f'document.querySelector("{MOTION}")._fullLayout.font.color')
    assert (sum(int(ink[k : k + 2], 16) for k in (1, 3, 5)) / 3 > 180) is dark
    wide = "document.querySelector('nav').scrollWidth"
    bar = browser.js(f"{wide} <= document.querySelector('nav').clientWidth")
    assert bar and browser.complaints() == []


@pytest.mark.long
def test_a_page_without_conclusions_shows_its_reason_first(browser, no_conclusion):
    browser.open(no_conclusion / "report.html", 400, 844)
    place = "document.querySelector('.badge.stop').getBoundingClientRect()"
    box = json.loads(browser.js(f"JSON.stringify({place})"))
    assert 0 < box["top"] and box["bottom"] < 844 and 0 <= box["left"] and box["right"] <= 400


@pytest.mark.parametrize(
    "name",
    ["simulate", pytest.param("posterior", marks=pytest.mark.long)],
)
def test_the_page_of_a_vehicle_with_a_hostile_name_animates_its_motion(browser, user_runs, name):
    browser.open(user_runs[name] / "report.html", 640, 240)  # the processor paints each pixel
    browser.show(MOTION)
    assert browser.js("window.hacked === undefined") and browser.complaints() == []
    assert HOSTILE in text(browser, "main")
    corners = f'[...document.querySelector("{MOTION}")._fullData[0].x]'
    before = np.array(browser.js(corners))
    browser.js(
        f"Plotly.animate(document.querySelector(\"{MOTION}\"), ['20'], {{frame: {{duration: 0}}}})"
    )
    browser.until(
        f'Math.abs(document.querySelector("{MOTION}")._fullData[0].x[0] - {before[0]}) > 1e-4', 10
    )
    eye = f'JSON.stringify(document.querySelector("{MOTION}")._fullLayout.scene.camera.eye)'
    browser.js(f'document.querySelector("{MOTION}").focus()')
    seen = browser.js(eye)
    browser.key("ArrowLeft")
    browser.until(f"{eye} !== {json.dumps(seen)}", 5)


def test_a_narrow_window_sees_a_view_from_farther_away(browser, user_runs):
    """Else the titles of the axes are cut at 420 pixels."""
    distance = []
    for width in (420, 900):
        browser.open(user_runs["simulate"] / "report.html", width, 240)
        browser.show(MOTION)
        eye = f'document.querySelector("{MOTION}")._fullLayout.scene.camera.eye'
        distance.append(browser.js(f"Math.hypot({eye}.x, {eye}.y, {eye}.z)"))
    assert distance[0] == pytest.approx(1.3 * distance[1], rel=1e-3)


def contrast(a: str, b: str) -> float:
    """Contrast of two colours "rgb(r, g, b)" by WCAG 2: 1 to 21."""
    levels = []
    for colour in (a, b):
        part = np.array([float(x) for x in colour[4:-1].split(",")[:3]]) / 255
        part = np.where(part <= 0.04045, part / 12.92, ((part + 0.055) / 1.055) ** 2.4)
        levels.append(part @ [0.2126, 0.7152, 0.0722] + 0.05)
    return max(levels) / min(levels)


def test_the_time_of_the_animation_is_legible_in_both_themes(browser, user_runs):
    browser.open(user_runs["simulate"] / "report.html", 640, 240)
    browser.show(MOTION)
    label = f'getComputedStyle(document.querySelector("{MOTION} .slider-label"))'
    paper = "getComputedStyle(document.body).backgroundColor"

    def measured() -> float:
        assert browser.js(f"{label}.fillOpacity") == "1"
        return contrast(browser.js(f"{label}.fill"), browser.js(paper))

    assert measured() > 4.5
    browser.js(
        f"Plotly.animate(document.querySelector(\"{MOTION}\"), ['5'], {{frame: {{duration: 0}}}})"
    )
    assert measured() > 4.5
    browser.js("document.getElementById('theme').click()")
    assert measured() > 4.5


def test_the_browser_test_detects_a_request(browser, tmp_path):
    """A negative control of the tests above."""
    path = tmp_path / "bad.html"
    page = (
        "<!doctype html><img src='http://127.0.0.1:9/x.png'><script>console.error('bad')</script>"
    )
    path.write_text(page, "utf-8")
    browser.open(path)
    assert any(url.startswith("http://127.0.0.1") for url in browser.requests())
    assert any("bad" in line for line in browser.complaints())
