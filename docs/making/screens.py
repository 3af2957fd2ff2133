"""Draw the pictures of the page for the documents with headless Chromium: report.png, view.png, glance.png,
widget.png.

    etendue run pipelines/sweep.toml && etendue run pipelines/smallest.toml
    python docs/making/screens.py --sweep sweep --small smallest -o docs/pages

Needs playwright and a Chromium (``--chromium``). The widget is the page in its frame, with answers from a kernel;
``python benchmarks/jupyter.py -o shot.png`` tests it in a real JupyterLab.
"""

from __future__ import annotations

import argparse
import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from PIL import Image

import etendue
from etendue.present.page.html import page, static
from etendue.present.page.live import Live
from etendue.present.page.notebook import answer
from etendue.present.page.report import report
from etendue.present.page.server import Server

FLAGS = ["--no-sandbox", "--disable-gpu", "--disable-background-networking", "--disable-dev-shm-usage"]
WAIT = 120_000  # ms: a loaded machine is slow, not wrong
PICTURE = "encode: RGB display"
SLIDE = """([axis, last]) => {
  const slider = document.querySelector(`input[data-axis=${axis}]`);
  slider.value = last ? slider.max : 0; slider.dispatchEvent(new Event('input')); }"""
LOADED = "() => [...document.images].every((one) => one.complete && one.naturalWidth > 0)"
HOLDER = """async ([source, html]) => {  // a notebook's part: a model with a channel, and a place for the widget
  const file = URL.createObjectURL(new Blob([source], { type: 'text/javascript' }));
  const widget = (await import(file)).default, heard = [];
  window.hear = (said, bytes) => heard.forEach(
    (one) => one(said, bytes.map((b) => new DataView(Uint8Array.from(b).buffer))));
  const values = { html, height: 720 }, model = { get: (name) => values[name],
    on: (_, one) => heard.push(one), off: () => {} };
  model.send = (asked) => window.kernel(asked);
  document.body.style.margin = 0;
  widget.render({ model, el: document.body }); }"""


@contextmanager
def tab(browser: Any, width: int, height: int) -> Iterator[Any]:
    """A tab in light colours."""
    context = browser.new_context(viewport={"width": width, "height": height}, color_scheme="light")
    made = context.new_page()
    made.set_default_timeout(WAIT)
    try:
        yield made
    finally:
        context.close()


def first_screen(browser: Any, archive: Path, path: Path) -> None:
    """The report as it opens."""
    with tempfile.TemporaryDirectory() as folder, tab(browser, 1280, 800) as shown:
        report(archive, Path(folder) / "report.html")
        shown.goto((Path(folder) / "report.html").as_uri())
        shown.wait_for_selector("#front svg .star")
        shown.wait_for_function(LOADED)
        shown.screenshot(path=str(path))


def live(browser: Any, archive: Path, path: Path) -> None:
    """Two stages under the pointer."""
    with Server(Live(archive)) as server, tab(browser, 1180, 1000) as shown:
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.02})
        thread.start()
        try:
            shown.goto(server.url)
            shown.wait_for_selector(".panes[data-shown]")
            panes(shown)
            canvas = shown.locator(".pixels").first
            canvas.scroll_into_view_if_needed()
            shown.evaluate("() => document.querySelector('.toolbar').scrollIntoView({ block: 'start' })")
            box = canvas.bounding_box()
            shown.mouse.move(box["x"] + 0.4 * box["width"], box["y"] + 0.35 * box["height"])
            shown.mouse.wheel(0, -240)
            shown.mouse.click(box["x"] + 0.45 * box["width"], box["y"] + 0.3 * box["height"])
            shown.wait_for_selector("[data-probe='encode.rgb_display'][data-row]")
            shown.wait_for_timeout(1000)
            shown.screenshot(path=str(path))
        finally:
            server.shutdown()
            thread.join()


def panes(shown: Any) -> None:
    """The raw frame beside the picture."""
    boxes = shown.get_by_role("combobox", name="picture")
    boxes.nth(0).select_option(label="ADC: raw")
    boxes.nth(1).select_option(label=PICTURE)
    shown.wait_for_timeout(1000)


def at_a_glance(browser: Any, archive: Path, path: Path) -> None:
    """``tree.etendue`` as a notebook shows it."""
    with tab(browser, 980, 800) as shown:
        shown.set_content(
            f'<body style="font:14px/1.35 sans-serif">{etendue.open_archive(archive).etendue._repr_html_()}</body>'
        )
        shown.wait_for_function(LOADED)
        shown.screenshot(path=str(path), full_page=True)


def widget(browser: Any, archive: Path, path: Path) -> None:
    """The page in a notebook's frame, its sliders moved to the last of their values."""
    shown_by = Live(archive)
    questions: list[Any] = []
    with tab(browser, 1050, 722) as shown:

        class Channel:
            def send(self, said: Any, buffers: Any = ()) -> None:
                shown.evaluate("([said, bytes]) => hear(said, bytes)", [said, [list(one) for one in buffers]])

        def answered(rounds: int) -> None:
            for _ in range(rounds):
                shown.wait_for_timeout(50)
                while questions:
                    answer(shown_by, Channel(), questions.pop(0))

        shown.expose_function("kernel", lambda asked: questions.append(asked))
        shown.evaluate(HOLDER, [static("notebook.js"), page(shown_by.shown("frame"))])
        frame = None
        while frame is None or not frame.locator(".panes[data-shown]").count():
            answered(4)
            frame = next((one for one in shown.frames if one.parent_frame), None)
        boxes = frame.get_by_role("combobox", name="picture")
        boxes.nth(0).select_option(label="ADC: raw")
        boxes.nth(1).select_option(label=PICTURE)
        for axis in frame.evaluate(
            "() => [...document.querySelectorAll('input[data-axis]')].map((one) => one.dataset.axis)"
        ):
            frame.evaluate(SLIDE, [axis, True])
        answered(60)
        frame.evaluate("() => document.querySelector('#live').scrollIntoView({ block: 'start' })")
        answered(10)
        shown.screenshot(path=str(path))


MADE = {
    "report.png": (first_screen, "sweep"),
    "view.png": (live, "small"),
    "glance.png": (at_a_glance, "small"),
    "widget.png": (widget, "small"),
}


def main() -> None:
    """Draw all four into a folder."""
    from playwright.sync_api import sync_playwright

    asked = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    asked.add_argument("--sweep", type=Path, required=True, help="an archive of pipelines/sweep.toml")
    asked.add_argument("--small", type=Path, required=True, help="an archive of pipelines/smallest.toml")
    asked.add_argument("-o", "--output", type=Path, required=True, help="a folder")
    asked.add_argument("--chromium", default="/usr/bin/chromium")
    given = asked.parse_args()
    archives = {"sweep": given.sweep, "small": given.small}
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=given.chromium, args=FLAGS, timeout=WAIT)
        for name, (draw, archive) in MADE.items():
            path = given.output / name
            draw(browser, archives[archive], path)
            Image.open(path).convert("RGB").save(path, optimize=True)
            print(f"{path}  {path.stat().st_size / 1e3:.0f} kB")
        browser.close()


if __name__ == "__main__":
    main()
