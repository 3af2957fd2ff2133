"""Report and live page in a real browser: nothing is asked of a network, nothing breaks, and what is clicked does
what it says.
"""

import json
import os
import re
import shutil
import threading

import numpy as np
import pytest
import xarray

from etendue.present.page.live import Live
from etendue.present.page.report import report
from etendue.present.page.server import Server

pytestmark = pytest.mark.long
CHROMIUM = os.environ.get("ETENDUE_CHROMIUM") or shutil.which("chromium") or "/usr/bin/chromium"
FLAGS = ["--no-sandbox", "--disable-gpu", "--disable-background-networking", "--disable-dev-shm-usage"]
WAIT = 120_000  # ms: a loaded machine is slow, not wrong


def expect(locator):
    """What a page has to come to: asked without evaluating text in it, which it forbids."""
    from playwright.sync_api import expect

    expect.set_options(timeout=WAIT)
    return expect(locator)


@pytest.fixture(scope="module")
def browser():
    playwright = pytest.importorskip(
        "playwright.sync_api", reason="playwright is not installed: pip install playwright"
    )
    if not os.access(CHROMIUM, os.X_OK):
        pytest.skip(f"no browser: {CHROMIUM} is not there (apt-get install chromium, or set ETENDUE_CHROMIUM)")
    with playwright.sync_playwright() as started:
        own = started.chromium.launch(executable_path=CHROMIUM, args=FLAGS, timeout=WAIT)
        yield own
        own.close()


SLIDE = """([axis, place]) => {
  const slider = document.querySelector(`input[data-axis=${axis}]`);
  slider.value = place; slider.dispatchEvent(new Event('input')); }"""
WIPE = "(place) => { const w = document.getElementById('wipe'); w.value = place; w.dispatchEvent(new Event('input')); }"
KEEP = """(name) => {
  const c = document.querySelector('.pixels');
  window[`kept_${name}`] = c.getContext('2d').getImageData(0, 0, c.width, c.height); }"""
SAME = """([p, q, from, to]) => {  // between two shares of the width
  const a = window[`kept_${p}`], b = window[`kept_${q}`];
  const first = 4 * Math.ceil(from * a.width), last = 4 * Math.floor(to * a.width);
  for (let row = 0; row < a.data.length; row += 4 * a.width)
    for (let i = row + first; i < row + last; i++) if (a.data[i] !== b.data[i]) return false;
  return true; }"""
PIXEL = """([x, y]) => {
  const c = document.querySelector('.pixels'), k = c.width / c.clientWidth;
  return [...c.getContext('2d').getImageData(x * k, y * k, 1, 1).data]; }"""
CONTRAST = """() => {  // the least ratio of any text to what is behind it, as WCAG 2 defines it
  const linear = (v) => (v / 255 <= 0.04045 ? v / 255 / 12.92 : ((v / 255 + 0.055) / 1.055) ** 2.4);
  const read = (text) => text.match(/[\\d.]+/g).map(Number);
  const luminance = (text) => { const [r, g, b] = read(text).map(linear);
    return 0.2126 * r + 0.7152 * g + 0.0722 * b; };
  const own = (node) => [...node.childNodes].some((child) => child.nodeType === 3 && child.textContent.trim());
  const found = [];
  const kinds = 'p, dt, dd, h1, h2, h3, a, span, td, th, button, summary, code, li, strong';
  for (const node of document.querySelectorAll(kinds)) {
    if (!node.offsetParent || !own(node)) continue;
    let under = node;
    while (under && read(getComputedStyle(under).backgroundColor)[3] === 0) under = under.parentElement;
    const a = luminance(getComputedStyle(node).color),
      b = luminance(getComputedStyle(under || document.body).backgroundColor);
    found.push([(Math.max(a, b) + 0.05) / (Math.min(a, b) + 0.05), node.textContent.slice(0, 40)]);
  }
  return found.sort((p, q) => p[0] - q[0])[0]; }"""


class Watched:
    """A tab, what it has asked for, and what it has complained of."""

    def __init__(self, browser, url, **kind):
        self.context = browser.new_context(viewport={"width": 1200, "height": 900}, accept_downloads=True, **kind)
        self.page = self.context.new_page()
        self.page.set_default_timeout(WAIT)
        self.asked, self.complaints = [], []
        self.page.on("request", lambda request: self.asked.append(request.url))
        self.page.on(
            "console",
            lambda message: self.complaints.append(message.text) if message.type in ("error", "warning") else None,
        )
        self.page.on("pageerror", lambda error: self.complaints.append(str(error)))
        self.page.goto(url)
        self.page.wait_for_selector("#page[data-ready=yes]")

    def scroll_through(self):
        height = self.page.evaluate("document.documentElement.scrollHeight")
        for y in range(0, height, 500):
            self.page.evaluate(f"scrollTo(0, {y})")
            self.page.wait_for_timeout(20)

    def slide(self, axis, place):
        self.page.evaluate(SLIDE, [axis, place])


@pytest.fixture(scope="module")
def file(archive, tmp_path_factory):
    path = tmp_path_factory.mktemp("browser") / "report.html"
    report(archive, path)
    return path


@pytest.fixture
def opened(browser, file):
    tab = Watched(browser, file.as_uri())
    yield tab
    tab.context.close()


@pytest.fixture(scope="module")
def live(archive):
    with Server(Live(archive)) as server:
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.02})
        thread.start()
        try:
            yield server.url
        finally:
            server.shutdown()
            thread.join()


@pytest.fixture
def viewer(browser, live):
    tab = Watched(browser, live)
    tab.page.wait_for_selector(".panes[data-shown]")
    yield tab
    tab.context.close()


def stored(archive, stage, variable, **labels):
    data = xarray.open_dataset(archive / "data.zarr", engine="zarr", group=stage)[variable]
    return data.sel({dim: value for dim, value in labels.items() if dim in data.dims}).to_numpy()


# ---- the report


def test_a_report_asks_no_network_for_anything_and_complains_of_nothing(opened, file):
    opened.scroll_through()
    opened.slide("f_number", 2)
    opened.page.click("#theme")
    opened.page.wait_for_timeout(300)
    assert [url for url in opened.asked if not url.startswith(("data:", "blob:")) and url != file.as_uri()] == []
    assert opened.complaints == []


FIRST = """() => {  // what stands on the first screen, and how low it reaches
  const bottom = (which) => document.querySelector(which).getBoundingClientRect().bottom;
  return {
    reach: Math.max(...['#cell .tile.large', '#front svg', '#cell .wrong', '#cell .limits', '#cell .kept'].map(bottom)),
    open: [...document.querySelectorAll('dl.big dt')].map((one) => one.textContent),
    tables: document.querySelectorAll('#subjects details[open]').length,
    title: document.querySelector('#cell h2').textContent }; }"""


def test_the_first_screen_holds_picture_front_limit_figures_and_error(browser, file):
    tab = Watched(browser, file.as_uri())
    tab.page.set_viewport_size({"width": 1280, "height": 800})
    tab.page.wait_for_selector("#front svg .star")
    found = tab.page.evaluate(FIRST)
    tab.context.close()
    assert found["reach"] <= 800 and found["title"].startswith("Build f/")
    assert 1 <= len(found["open"]) <= 8 and len(set(found["open"])) == len(found["open"]) and found["tables"] == 0


def test_beside_the_choice_stands_what_was_swept_and_where_its_axis_ends(browser, file, deep):
    """f/8, f/2, f/4 and 2 and 8 ms: an end is the least or the most, wherever it stands; of three values the middle
    is none.
    """
    for page, others in ((file, ["2 ms to 8 ms"]), (deep[1], ["2 ms to 8 ms", "3 µm to 6 µm"])):
        tab = Watched(browser, page.as_uri())
        said, title = tab.page.inner_text("#cell .swept"), tab.page.inner_text("#cell h2")
        axis = tab.page.locator("#front .axes text").all_text_contents()
        tab.context.close()
        assert "f-number f/2 to f/8" in said and all(own in said for own in others)
        ends = [
            end for end in ("f/2", "f/8", "2 ms", "8 ms", "3 µm", "6 µm") if re.search(rf"{re.escape(end)}(,|$)", title)
        ]
        told = said.partition(".")[2]
        assert [end for end in ("f/2", "f/8", "2 ms", "8 ms", "3 µm", "6 µm") if end in told] == ends and bool(
            ends
        ) == ("try values beyond" in told)
        assert any("mean SNR" in text for text in axis)


def test_the_front_of_the_trade_offs_is_that_of_the_choice(opened):
    """What clips is faint in both, and on neither."""
    page = opened.page
    page.locator("#trade-plot").scroll_into_view_if_needed()
    page.wait_for_selector("#trade-plot svg .chosen")
    marks = page.locator("#front svg .front-dot").count(), page.locator("#trade-plot svg .front-dot").count()
    assert marks[0] == marks[1] > 0


def test_a_long_name_makes_no_page_wider_than_a_telephone(browser, file):
    tab = Watched(browser, file.as_uri())
    tab.page.set_viewport_size({"width": 390, "height": 844})
    tab.page.evaluate(
        "document.querySelectorAll('select').forEach((s) => { s.options[0].textContent = 'frequency of half contrast "
        "'.repeat(4); })"
    )
    tab.scroll_through()
    assert tab.page.evaluate("document.documentElement.scrollWidth") == 390
    tab.context.close()


def test_a_dot_of_the_front_goes_there_and_back(opened):
    page = opened.page
    chosen = page.locator(".slider output").all_text_contents()
    opened.slide("f_number", 2 if not chosen[0].endswith("8") else 0)
    expect(page.locator("#cell .moved button")).to_have_count(1)
    expect(page.locator("#cell .wrong h3")).to_have_text("Error of the choice")  # it does not move with the sliders
    page.click("#cell .moved button")
    expect(page.locator("#cell .moved button")).to_have_count(0)
    expect(page.locator("#cell .wrong h3")).to_have_text("Error of this cell")
    assert page.locator(".slider output").all_text_contents() == chosen


def test_hostile_texts_stay_texts(opened):
    assert opened.page.title() == "shown · etendue"
    assert "<script>document.title='owned'</script>" in opened.page.inner_text("header")
    assert opened.page.query_selector("img[src=x]") is None


def test_sliders_are_labelled_and_move_figures_and_pictures(opened, archive):
    page = opened.page
    opened.slide("f_number", 0)
    page.wait_for_timeout(200)
    before = page.get_attribute("#cell .tile.large img", "src")
    label = page.locator(".slider", has_text="f-number")
    assert "f/2" in label.inner_text()
    opened.slide("f_number", 2)
    expect(page.locator(".slider output").first).to_have_text("f/8")
    assert page.get_attribute("#cell .tile.large img", "src") != before
    value = float(stored(archive, "exposure_report", "mean_snr", f_number=8.0, integration_time=0.008))
    assert f"{value:.3g}" in page.inner_text("#cell")


def test_the_keyboard_moves_sliders_and_maps(opened):
    page = opened.page
    opened.slide("f_number", 1)
    page.focus("input[data-axis=f_number]")
    page.keyboard.press("ArrowRight")
    expect(page.locator(".slider output").first).to_have_text("f/8")
    page.locator("#map").scroll_into_view_if_needed()
    page.locator("#map svg").focus()
    page.keyboard.press("ArrowLeft")
    expect(page.locator(".slider output").first).to_have_text("f/4")
    assert page.evaluate("document.activeElement.closest('#map') !== null")


def test_tables_are_files_with_the_archive_s_numbers(opened, archive):
    page = opened.page
    with page.expect_download() as waiting:
        page.click("button[data-csv='figures-f_number-integration_time']")
    rows = [line.split(",") for line in waiting.value.path().read_text().splitlines()]
    column = next(n for n, name in enumerate(rows[0]) if name.startswith("exposure_report.mean_snr"))
    assert rows[0][:2] == ["f_number", "integration_time [s]"] and len(rows) == 1 + 6
    for row in rows[1:]:
        value = stored(archive, "exposure_report", "mean_snr", f_number=float(row[0]), integration_time=float(row[1]))
        assert float(row[column]) == float(value)


@pytest.mark.parametrize("kind", [{"color_scheme": "dark"}, {"color_scheme": "light"}])
def test_every_text_has_the_contrast_of_wcag_aa(browser, file, kind):
    tab = Watched(browser, file.as_uri(), **kind)
    worst = tab.page.evaluate(CONTRAST)
    tab.context.close()
    assert worst[0] >= 4.5, worst


@pytest.mark.parametrize("width", [360, 768, 1600])
def test_nothing_reaches_beyond_the_window(browser, file, width):
    tab = Watched(browser, file.as_uri())
    tab.page.set_viewport_size({"width": width, "height": 800})
    tab.scroll_through()
    assert tab.page.evaluate("document.documentElement.scrollWidth <= innerWidth")
    tab.context.close()


DEEP = """
name = "deep"
seed = 1
[camera]
peak_qe = [0.36, 0.44, 0.40]
focal_length = "6.93 mm"
[[stages]]
use = "uniform"
name = "scene"
white_luminance = "1000 cd m-2"
width = "48 um"
height = "48 um"
bin_width = "100 nm"
[[stages]]
use = "irradiance"
[[stages]]
use = "pixel"
rows = 4
columns = 4
[[stages]]
use = "mosaic"
[[stages]]
use = "exposure"
[[stages]]
use = "shot_noise"
[[stages]]
use = "adc"
[[stages]]
use = "exposure_report"
[sweep]
f_number = [2, 4, 8]
pixel_pitch = ["3 um", "6 um"]
integration_time = ["2 ms", "4 ms", "8 ms"]
full_well_density = ["100 electron um-2", "2000 electron um-2"]
"""
COLOUR = """([place, x, y]) => {  // what a map has painted at a share of one of its boxes
  const host = document.querySelector(place), canvas = host.querySelector('canvas');
  const k = canvas.width / canvas.clientWidth;
  return [...canvas.getContext('2d').getImageData(Math.round(x * k), Math.round(y * k), 1, 1).data]; }"""


@pytest.fixture(scope="module")
def deep(tmp_path_factory):
    from etendue.contract.registry import installed_stages
    from etendue.pipeline.file import parse_pipeline
    from etendue.plan.planner import make_plan
    from etendue.session import Options, execute

    folder = tmp_path_factory.mktemp("deep") / "deep"
    execute(make_plan(parse_pipeline(DEEP), installed_stages()), folder, Options("serial"))
    path = folder.with_suffix(".html")
    report(folder, path)
    return folder, path


@pytest.fixture
def panelled(browser, deep):
    tab = Watched(browser, deep[1].as_uri())
    tab.page.locator("#maps select[aria-label=figure]").select_option("exposure_report.mean_snr")
    tab.page.locator("#panels").scroll_into_view_if_needed()
    tab.page.wait_for_selector("#panels svg .panel.now")
    yield tab
    assert tab.complaints == []
    tab.context.close()


def boxes(page, which):
    return page.evaluate(
        "(which) => [...document.querySelectorAll(which)].map((r) => ['x', 'y', 'width', 'height'].map((n) => "
        "Number(r.getAttribute(n))))",
        which,
    )


def test_further_axes_are_panels_that_a_click_and_the_keyboard_move_between(panelled):
    page = panelled.page
    assert len(boxes(page, "#panels .panel")) == 6 and len(boxes(page, "#panels .panel.now")) == 1
    titles = page.locator("#panels .titles text").all_text_contents()
    assert [text for text in titles if text.endswith("ms")] == ["2 ms", "4 ms", "8 ms"]
    assert sum("full_well" in text for text in titles) == 2
    time = page.locator("input[data-axis=integration_time]")
    for place in (0, 2):
        panelled.slide("integration_time", place)
        page.wait_for_timeout(150)
        x, y, width, height = boxes(page, "#panels .panel.now")[0]
        page.locator("#panels svg").click(
            position={"x": x + width / 6, "y": y + height * 0.75}
        )  # the first column, the lowest row
        expect(page.locator("input[data-axis=f_number]")).to_have_value("0")
        expect(page.locator("input[data-axis=pixel_pitch]")).to_have_value("0")
        assert time.input_value() == str(place)
    page.locator("#panels svg").focus()
    page.keyboard.press("ArrowLeft")
    expect(time).to_have_value("1")
    assert page.evaluate("document.activeElement.closest('#panels') !== null")


def test_a_value_has_one_colour_in_the_map_and_in_every_panel(panelled, deep):
    page = panelled.page
    snr = xarray.open_dataset(deep[0] / "data.zarr", engine="zarr", group="exposure_report")["mean_snr"]
    panelled.slide("integration_time", 1)
    panelled.slide("full_well_density", 0)
    panelled.slide("f_number", 2)
    panelled.slide("pixel_pitch", 1)
    page.wait_for_timeout(300)
    chosen = boxes(page, "#map rect.chosen")[0]
    same = page.evaluate(COLOUR, ["#map", chosen[0] + chosen[2] * 0.15, chosen[1] + chosen[3] * 0.3])
    x, y, width, height = boxes(page, "#panels .panel.now")[0]
    small = page.evaluate(COLOUR, ["#panels", x + width * (5 / 6 + 0.08), y + height * 0.12])
    np.testing.assert_allclose(small, same, atol=3)  # 256 steps of the colours
    texts = page.locator("#panels .numbers text").all_text_contents()
    assert sorted(map(float, texts)) == pytest.approx(
        sorted(snr.values.ravel().tolist()), rel=5e-3
    )  # every cell once, three digits


# ---- the live page


def test_the_viewer_shows_the_store_s_pixels(viewer, archive):
    page = viewer.page
    page.get_by_role("combobox", name="picture").first.select_option(label="encode: RGB display")
    page.wait_for_timeout(500)
    viewer.slide("f_number", 1)
    viewer.slide("integration_time", 1)
    page.wait_for_selector(".panes[data-shown='f_number:1,integration_time:1']")
    page.wait_for_timeout(300)
    box = page.locator(".pixels").first.bounding_box()
    page.mouse.move(box["x"] + 0.4 * box["width"], box["y"] + 0.55 * box["height"])
    page.wait_for_selector("[data-probe='encode.rgb_display'][data-row]")
    told = page.locator("[data-probe='encode.rgb_display']")
    row, column = int(told.get_attribute("data-row")), int(told.get_attribute("data-column"))
    values = stored(archive, "encode", "rgb_display", f_number=4.0, integration_time=0.008)[:, row, column]
    assert json.loads(told.get_attribute("data-values")) == values.astype(float).tolist()
    at = [0.38 * box["width"], 0.53 * box["height"]]  # beside the crosshair, in the same pixel or the next
    seen = page.evaluate(PIXEL, at)
    whole = stored(archive, "encode", "rgb_display", f_number=4.0, integration_time=0.008)
    near = (
        np.round(np.clip(whole[:, max(0, row - 1) : row + 2, max(0, column - 1) : column + 2], 0, 1) * 255)
        .reshape(3, -1)
        .T.tolist()
    )
    assert seen[:3] in near  # nearest neighbour: a colour that a pixel has, none between two
    assert viewer.complaints == []


def test_panes_are_linked_and_the_wipe_lies_between_two_stages(viewer):
    page = viewer.page
    box = page.locator(".pixels").first.bounding_box()
    page.mouse.move(box["x"] + 100, box["y"] + 100)
    before = page.inner_text("#pane-status")
    page.mouse.wheel(0, -480)
    expect(page.locator("#pane-status")).not_to_have_text(before)
    factor = [float(re.match(r"([\d.]+)", text).group(1)) for text in (before, page.inner_text("#pane-status"))]
    assert factor[1] / factor[0] == pytest.approx(4, rel=0.02)  # two doublings; three digits are shown
    page.get_by_text("Wipe A | B").click()
    page.wait_for_timeout(500)
    for name, share in (("b", 0), ("a", 1000), ("both", 500)):
        page.evaluate(WIPE, share)
        page.wait_for_timeout(300)
        page.evaluate(KEEP, name)
    assert page.evaluate(SAME, ["a", "b", 0, 1]) is False
    assert page.evaluate(SAME, ["both", "a", 0, 0.48]) and page.evaluate(SAME, ["both", "b", 0.52, 1])


def test_line_and_histogram_follow(viewer):
    page = viewer.page
    box = page.locator(".pixels").first.bounding_box()
    page.mouse.click(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    page.locator("#line-plot").scroll_into_view_if_needed()
    page.wait_for_selector("#line-plot svg path")
    page.locator("#histogram").scroll_into_view_if_needed()
    page.wait_for_selector("#histogram table")
    assert "clipped" in page.inner_text("#histogram")
    assert viewer.complaints == []


def test_the_viewer_asks_its_own_server_alone(viewer, live):
    viewer.scroll_through()
    assert [url for url in viewer.asked if not url.startswith((live, "data:", "blob:"))] == []


# ---- in a notebook

HOLDER = """async ([source, html]) => {  // a notebook's part: a model with a channel, and a place for the widget
  const file = URL.createObjectURL(new Blob([source], { type: 'text/javascript' }));
  const widget = (await import(file)).default, heard = [];
  window.hear = (answer, bytes) => heard.forEach(
    (one) => one(answer, bytes.map((b) => new DataView(Uint8Array.from(b).buffer))));
  const values = { html, height: 800 }, model = { get: (name) => values[name],
    on: (_, one) => heard.push(one), off: () => {} };
  model.send = (asked) => window.kernel(asked);
  widget.render({ model, el: document.body }); }"""


def test_in_a_notebook_the_same_page_asks_its_kernel(browser, archive):
    from etendue.present.page.html import page, static
    from etendue.present.page.notebook import answer

    live = Live(archive)
    context = browser.new_context(viewport={"width": 1200, "height": 900})
    tab, complaints, answers = context.new_page(), [], []
    tab.set_default_timeout(WAIT)
    tab.on("pageerror", lambda error: complaints.append(str(error)))

    class Channel:
        def send(self, said, buffers=()):
            answers.append(said)
            tab.evaluate("([said, bytes]) => hear(said, bytes)", [said, [list(one) for one in buffers]])

    questions = []
    tab.expose_function("kernel", lambda asked: questions.append(asked))
    tab.evaluate(HOLDER, [static("notebook.js"), page(live.shown("frame"))])
    frame = tab.frame_locator("iframe")
    for _ in range(600):  # the kernel's loop: what was asked is answered in turn
        tab.wait_for_timeout(50)
        while questions:
            answer(live, Channel(), questions.pop(0))
        if frame.locator(".panes[data-shown]").count():
            break
    assert frame.locator(".panes[data-shown]").count() == 1
    assert not complaints and answers and not [said for said in answers if "why" in said]
    context.close()
