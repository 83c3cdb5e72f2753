"""The report in a real browser: quiet, complete, moving, and true to the files it was made from.

The quick tests open the page of a run of `simulate`; those of the whole study's page, thirty seconds of painting, are long.
"""

from __future__ import annotations

import io
import json
import math

import numpy as np
import pytest
import xarray as xr
from matplotlib.image import imread

from browser import HOSTILE, Browser
from sunspin.vehicle.timeline import utc_seconds

pytestmark = pytest.mark.browser

STAGE = "#lander-stage"
TOP = "document.getElementById('lander-app').scrollIntoView({block: 'start', behavior: 'instant'})"


@pytest.fixture(scope="module")
def page(browser, study) -> Browser:
    """The study's page, wide enough for two columns and light, every plot drawn: the processor paints each pixel."""
    browser.open(study / "report.html", 900, 640)
    for name in browser.js(
        "[...document.querySelectorAll('[data-plot]')].map(e => e.parentElement.id)"
    ):
        browser.show(f"[id='{name}'] [data-plot]")
    browser.show("#slices-plot")
    browser.show(STAGE)
    return browser


def pixels(browser: Browser, selector: str) -> np.ndarray:
    """Colours (height, width, 3) of the part of the window that an element fills."""
    box = json.loads(
        browser.js(
            f"(() => {{const r = document.querySelector({json.dumps(selector)}).getBoundingClientRect();"
            "return JSON.stringify({x: r.x + scrollX, y: r.y + scrollY, width: r.width, height: r.height})})()"
        )
    )
    return imread(io.BytesIO(browser.picture(clip=box)))[..., :3]


def seek(browser: Browser, time: float) -> None:
    """Move the slider as a hand would."""
    browser.js(
        f"(() => {{const s = document.getElementById('lander-slider'); s.value = {time};"
        "s.dispatchEvent(new Event('input', {bubbles: true}))})()"
    )
    browser.js("new Promise(done => setTimeout(done, 250))")


def choose(browser: Browser, select: str, value: str) -> None:
    browser.js(
        f"(() => {{const s = document.querySelector({json.dumps(select)}); s.value = {json.dumps(value)};"
        "s.dispatchEvent(new Event('change', {bubbles: true}))})()"
    )


def text(browser: Browser, selector: str) -> str:
    return browser.js(f"document.querySelector({json.dumps(selector)}).textContent")


@pytest.mark.long
@pytest.mark.evidence("report", "validated", "Chromium: no error, no request, every plot drawn")
def test_it_is_quiet_and_asks_nobody(page):
    assert page.complaints() == []
    outside = [url for url in page.requests() if not url.startswith(("file:", "data:", "blob:"))]
    assert outside == []
    assert page.js(
        "[...document.querySelectorAll('[data-plot]')].every(e => e.dataset.drawn === 'yes')"
    )


@pytest.mark.long
def test_the_lander_is_there_and_turns(page):
    page.js(TOP)
    page.show(STAGE)
    page.js(TOP)
    choose(page, "#lander-motion", "0")
    seek(page, float(page.js("document.getElementById('lander-slider').min")))
    first = pixels(page, STAGE)
    background = first[2, 2]
    drawn = np.abs(first - background).max(axis=2) > 0.05
    assert 0.01 < drawn.mean() < 0.6, "a lander, not an empty or full canvas"
    assert len(np.unique((first[drawn] * 15).round(), axis=0)) > 20
    choose(page, "#lander-motion", "1")
    low, high = (
        float(page.js(f"document.getElementById('lander-slider').{end}")) for end in ("min", "max")
    )
    seek(page, (low + high) / 2 + 3.3)
    second = pixels(page, STAGE)
    assert np.mean(np.abs(second - first).max(axis=2) > 0.05) > 0.005


@pytest.mark.long
@pytest.mark.evidence(
    "report", "verified", "rate, wheel, panels and time shown, against the result files"
)
def test_the_readings_are_those_of_the_files(page, study):
    names = page.js("[...document.getElementById('lander-motion').options].map(o => o.textContent)")
    for k, name in enumerate(names):
        run = xr.load_dataset(
            study / f"motion-{name.lower().replace(' ', '-')}.nc", engine="h5netcdf"
        )
        choose(page, "#lander-motion", str(k))
        i = int((0.1 + 0.13 * k) * run.sizes["time"])  # before and after the collision
        seek(page, float(run["time"].values[i]))
        speed = float(np.linalg.norm(run["omega_B"].values[i]))
        assert float(text(page, "#lander-rate").split()[0]) == pytest.approx(
            np.degrees(speed), rel=6e-3
        )
        assert float(text(page, "[data-wheel='0']").split()[0]) == pytest.approx(
            run["wheel_speed_rad_s"].values[i, 0], abs=0.51
        )
        shown = [float(text(page, f"[data-panel='{p}']").split()[0]) for p in range(6)]
        cells = np.array([254, 162, 162, 162, 254, 230])
        assert shown == pytest.approx(100 * run["panel_signal"].values[i] / cells, abs=0.8)
        at = text(page, "#lander-time").removesuffix(" UTC").replace(" ", "T")
        assert utc_seconds(at, run.attrs["epoch_utc"]) == pytest.approx(
            run["time"].values[i], abs=0.51
        )
        assert run.attrs["about"][1:40] in text(page, "#lander-about")


@pytest.mark.long
@pytest.mark.evidence(
    "report", "verified", "the drawn attitude carries the Sun where the result file has it"
)
def test_what_is_drawn_is_the_stored_attitude(page, study):
    """The Sun's direction in the body, from the drawn vertices: the scene's Sun carried back by the drawn turn."""
    run = xr.load_dataset(study / "motion-best-fit.nc", engine="h5netcdf")
    names = page.js("[...document.getElementById('lander-motion').options].map(o => o.textContent)")
    choose(page, "#lander-motion", str(names.index("Best fit")))
    i = 1234
    seek(page, float(run["time"].values[i]))
    drawn = page.js(
        f"(() => {{const d = document.querySelector('{STAGE}').data[0]; return [d.x, d.y, d.z].map(a => [...a])}})()"
    )
    body = np.array(page.js("sunspin.data.lander.shape.vertices"))
    turn, *_ = np.linalg.lstsq(body, np.array(drawn).T, rcond=None)
    assert turn @ turn.T == pytest.approx(np.eye(3), abs=1e-5) and np.linalg.det(
        turn
    ) == pytest.approx(1, abs=1e-5)
    sun = np.array(page.js(f"sunspin.data.lander.motions[{names.index('Best fit')}].sun"))
    assert turn @ sun == pytest.approx(run["sun_B"].values[i], abs=2e-4)


@pytest.mark.long
def test_play_moves_time_and_space_stops_it(page):
    choose(page, "#lander-motion", "0")
    low = float(page.js("document.getElementById('lander-slider').min"))
    seek(page, low)
    page.js(f"document.querySelector('{STAGE}').focus()")
    page.key(" ")
    page.until(f"sunspin.lander.now() > {low} + 1", 10)
    page.key(" ")
    stopped = page.js("sunspin.lander.now()")
    page.js("new Promise(done => setTimeout(done, 200))")
    assert page.js("sunspin.lander.now()") == stopped


@pytest.mark.long
def test_jump_to_an_event(page):
    choose(page, "#lander-motion", "0")
    options = page.js(
        "[...document.getElementById('lander-event').options].map(o => [o.textContent, o.value])"
    )
    label, value = next(o for o in options if o[0].startswith("collision"))
    choose(page, "#lander-event", value)
    assert label.split(", ")[1][:8] in text(page, "#lander-time") and "16:20:00" in label


@pytest.mark.long
def test_views_change_what_is_shown(page):
    page.show("#figure-lines [data-plot]")
    visible = (
        "document.querySelector('#figure-lines [data-plot]').data.map(d => d.visible !== false)"
    )
    first = page.js(visible)
    choose(page, "[data-view-of='lines']", "1")
    page.js("new Promise(done => setTimeout(done, 300))")
    assert page.js(visible) != first and any(page.js(visible))


@pytest.mark.long
def test_slices_show_the_scan(page, study):
    page.show("#slices-plot")
    scan = xr.load_dataset(study / "scan_telemetry.nc", engine="h5netcdf")["emd"]
    for k in (0, scan.sizes["omega_z"] - 1):
        page.js(
            f"(() => {{const s = document.getElementById('slices-slider'); s.value = {k}; s.dispatchEvent(new Event('input'))}})()"
        )
        assert float(text(page, "#slices-value").split()[0]) == pytest.approx(
            float(scan["omega_z"][k]), abs=6e-4
        )
        z = np.array(page.js("document.getElementById('slices-plot').data[0].z"), dtype=float)
        step = math.log10(float(scan.max()) / float(scan.min())) / 254
        assert z.T == pytest.approx(np.log10(scan.isel(omega_z=k).values), abs=0.51 * step)


@pytest.mark.long
def test_rows_can_be_filtered(page, study):
    summary = json.loads((study / "summary.json").read_text("utf-8"))
    page.js("document.querySelector(\"button[data-filter='differs']\").click()")
    shown = page.js(
        "[...document.querySelectorAll('tr[data-row]:not([hidden])')].map(r => r.dataset.row)"
    )
    wanted = {r["id"] for r in summary["figures"] if r["agrees"] is False}
    assert set(shown) == wanted and wanted
    assert text(page, "#row-count") == f"{len(wanted)} rows"
    headings = page.js(
        "[...document.querySelectorAll('#comparison h3, #comparison h4')].filter(h => h.offsetHeight).map(h => h.textContent)"
    )
    parts = {r[key] for r in summary["figures"] if r["id"] in wanted for key in ("part", "section")}
    assert set(headings) == parts  # no heading without a row under it
    page.js("document.querySelector(\"button[data-filter='']\").click()")


@pytest.mark.long
def test_every_filter_shows_as_many_rows_as_it_says(page):
    labels = page.js(
        "[...document.querySelectorAll('button[data-filter]')].map(b => [b.dataset.filter, b.textContent])"
    )
    assert labels[0] == ["", "all"] and {"agrees", "differs", "put_in"} & {
        key.replace("-", "_") for key, _ in labels
    }
    total = 0
    for key, label in labels[1:]:
        page.js(f"document.querySelector(\"button[data-filter='{key}']\").click()")
        shown = page.js("document.querySelectorAll('tr[data-row]:not([hidden])').length")
        assert label.endswith(f"({shown})") and shown > 0
        total += shown
    page.js("document.querySelector(\"button[data-filter='']\").click()")
    assert page.js("document.querySelectorAll('tr[data-row]:not([hidden])').length") == total


@pytest.mark.long
def test_keys_turn_a_plot_and_reach_the_controls(page):
    page.show("#figure-lines [data-plot]")
    eye = "JSON.stringify(document.querySelector('#figure-lines [data-plot]')._fullLayout.scene.camera.eye)"
    page.js("document.querySelector('#figure-lines [data-plot]').focus()")
    before = page.js(eye)
    page.key("ArrowLeft")
    page.until(f"{eye} !== {json.dumps(before)}", 5)
    page.js("document.activeElement.blur(); scrollTo(0, 0)")
    reached = set()
    for _ in range(60):
        page.key("Tab")
        reached.add(
            page.js(
                "document.activeElement.id || document.activeElement.dataset.plot || document.activeElement.tagName"
            )
        )
    assert {"theme", "lander-motion", "lander-play", "lander-slider", "lander-stage"} <= reached


@pytest.mark.long
@pytest.mark.parametrize(
    ("width", "dark"), [(390, True), pytest.param(390, False, marks=pytest.mark.slow)]
)
def test_narrow_and_dark(browser, study, width, dark):
    browser.open(study / "report.html", width, 844, dark)
    browser.show("#figure-speed [data-plot]")
    assert browser.js("document.documentElement.scrollWidth <= innerWidth")
    paper = browser.js("getComputedStyle(document.body).backgroundColor")
    light = sum(int(x) for x in paper[4:-1].split(",")[:3]) / 3
    assert light < 60 if dark else light > 230
    ink = browser.js("document.querySelector('#figure-speed [data-plot]')._fullLayout.font.color")
    assert (sum(int(ink[k : k + 2], 16) for k in (1, 3, 5)) / 3 > 180) is dark
    assert browser.complaints() == []


@pytest.mark.long
@pytest.mark.parametrize("width", [390, pytest.param(1280, marks=pytest.mark.slow)])
def test_a_page_without_conclusions_shows_its_reason_first(browser, no_conclusion, width):
    browser.open(no_conclusion / "report.html", width, 844)
    box = json.loads(
        browser.js("JSON.stringify(document.querySelector('.badge.stop').getBoundingClientRect())")
    )
    assert 0 < box["top"] and box["bottom"] < 844 and 0 <= box["left"] and box["right"] <= width
    assert (
        browser.js("document.documentElement.scrollWidth <= innerWidth")
        and browser.complaints() == []
    )


@pytest.mark.long
def test_in_a_narrow_window_no_word_is_broken_or_cut(browser, study):
    browser.open(study / "report.html", 390, 844)
    broken = browser.js(
        """[...document.querySelectorAll('.controls label')].filter((label) => {
          const range = document.createRange(), word = label.firstChild;
          range.selectNode(word);
          return /^\\S+$/.test(word.textContent.trim()) && range.getBoundingClientRect().height > 30;
        }).map((label) => label.firstChild.textContent)"""
    )
    assert broken == []  # "Volume" stood in two lines, as "Volu" and "me"
    wide = browser.js(
        """[...document.querySelectorAll('figure.drawn > div')].filter((box) => {
          const drawing = box.querySelector('svg').getBoundingClientRect();
          return box.getBoundingClientRect().right > innerWidth || drawing.width < box.clientWidth - 1 && drawing.width < 300
            || getComputedStyle(box).overflowX !== 'auto';
        }).length"""
    )
    ends = "[...document.querySelectorAll('figure.drawn > .scroll')].map((box) => box.scrollWidth - box.clientWidth)"
    assert max(browser.js(ends)) <= 1  # drawn figures fit
    browser.js(
        "document.querySelectorAll('figure.drawn > .enlarge').forEach((button) => button.click())"
    )
    assert max(browser.js(ends)) > 100  # and are legible where that is asked for
    assert wide == 0 and browser.js("document.querySelectorAll('figure.drawn svg').length") >= 4
    assert browser.js("document.documentElement.scrollWidth <= innerWidth")


@pytest.mark.long
def test_it_prints_with_its_pictures(browser, study):
    browser.open(study / "report.html", dark=True)
    browser.js("dispatchEvent(new Event('beforeprint'))")
    browser.until("document.querySelectorAll('.print-image').length >= 2")
    assert browser.js("document.documentElement.dataset.theme") == "light"
    browser.js("dispatchEvent(new Event('afterprint'))")
    assert browser.js("document.documentElement.dataset.theme") == "dark"
    assert browser.js("document.querySelectorAll('.print-image').length") == 0


@pytest.mark.parametrize(
    "name",
    ["simulate", *(pytest.param(name, marks=pytest.mark.long) for name in ("rates", "posterior"))],
)
def test_a_users_run_with_a_hostile_name(browser, user_runs, name):
    browser.open(user_runs[name] / "report.html", 640, 480)  # the processor paints each pixel
    browser.js(TOP)
    browser.show(STAGE)
    assert browser.js("window.hacked === undefined") and browser.complaints() == []
    assert HOSTILE in text(browser, "main")
    before = text(browser, "#lander-time")
    seek(browser, float(browser.js("document.getElementById('lander-slider').max")))
    assert text(browser, "#lander-time") != before
    drawn = pixels(browser, STAGE)
    assert np.mean(np.abs(drawn - drawn[2, 2]).max(axis=2) > 0.05) > 0.01


def test_a_request_would_be_noticed(browser, tmp_path):
    """A negative control of the test above."""
    path = tmp_path / "bad.html"
    path.write_text(
        "<!doctype html><img src='http://127.0.0.1:9/x.png'><script>console.error('bad')</script>",
        "utf-8",
    )
    browser.open(path)
    assert any(url.startswith("http://127.0.0.1") for url in browser.requests())
    assert any("bad" in said for said in browser.complaints())
