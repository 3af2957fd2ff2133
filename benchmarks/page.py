"""Report and live page in a browser: size, time to load, time of a slider's step.

    python benchmarks/page.py [ARCHIVE ...] [--chromium /usr/bin/chromium]

An archive that is not there is none; without a name pipelines/sweep.toml is run first. Printed for each: the report's
bytes and the time to write it; in headless Chromium, from the first byte to a page that is drawn, and from a slider's
step to the frame that shows it, the median and the worst of 20; the same of the live page beside its server, where a
step ends when the new pictures are drawn. Needs playwright and a Chromium. Wall times: on a busy machine they are
longer.
"""

from __future__ import annotations

import argparse
import statistics
import tempfile
import threading
import time
from pathlib import Path
from typing import Any

from plain import HERE, plan_of

FLAGS = ["--no-sandbox", "--disable-gpu", "--disable-background-networking", "--disable-dev-shm-usage"]
STEPS = 20
STEP = """([axis, place, live]) => new Promise((done) => {
  const slider = document.querySelector(`input[data-axis=${axis}]`), begun = performance.now();
  slider.value = place; slider.dispatchEvent(new Event('input'));
  const area = document.querySelector('.panes');
  const shown = () => !live || !area || (area.dataset.shown || '').includes(`${axis}:${place}`);
  const look = () => requestAnimationFrame(() => (
    shown() ? setTimeout(() => done(performance.now() - begun), 0) : look()));
  look(); })"""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("archives", nargs="*", type=Path)
    parser.add_argument("--chromium", default="/usr/bin/chromium")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        archives = given.archives or [made(Path(folder) / "sweep")]
        from playwright.sync_api import sync_playwright

        print(f"{'archive':<14}{'page':<8}{'MB':>7}{'made':>8}{'load':>8}{'step':>9}{'worst':>9}{'requests':>10}")
        with sync_playwright() as playwright:
            browser = playwright.chromium.launch(executable_path=given.chromium, args=FLAGS)
            for archive in archives:
                say(archive, "report", *of_report(browser, archive, Path(folder) / "report.html"))
                say(archive, "live", *of_live(browser, archive))
            browser.close()


def say(archive: Path, page: str, size: int, made_in: float, load: float, steps: list[float], requests: int) -> None:
    step, worst = (f"{statistics.median(steps):.0f} ms", f"{max(steps):.0f} ms") if steps else ("-", "-")
    print(f"{archive.name:<14}{page:<8}{size / 1e6:7.2f}{made_in:6.1f} s{load:6.2f} s{step:>9}{worst:>9}{requests:>10}")


def made(folder: Path) -> Path:
    from etendue.session import Options, execute

    execute(plan_of(HERE.parent / "pipelines" / "sweep.toml"), folder, Options())
    return folder


def of_report(browser: Any, archive: Path, file: Path) -> tuple[int, float, float, list[float], int]:
    from etendue.present.page.report import report

    begun = time.perf_counter()
    written = report(archive, file)
    took = time.perf_counter() - begun
    return written.bytes, took, *looked_at(browser, file.as_uri(), live=False)


def of_live(browser: Any, archive: Path) -> tuple[int, float, float, list[float], int]:
    from etendue.present.page.live import Live
    from etendue.present.page.server import Server

    begun = time.perf_counter()
    with Server(Live(archive)) as server:
        took = time.perf_counter() - begun
        threading.Thread(target=server.serve_forever, daemon=True).start()
        size = len(server.live.answers[""]({})[1])
        found = looked_at(browser, server.url, live=True)
        server.shutdown()
    return size, took, *found


def looked_at(browser: Any, url: str, live: bool) -> tuple[float, list[float], int]:
    """Seconds to load, milliseconds of each step, requests over a network."""
    page = browser.new_page(viewport={"width": 1280, "height": 900})
    requests: list[str] = []
    page.on(
        "request",
        lambda request: requests.append(request.url) if request.url.startswith("http") and request.url != url else None,
    )
    begun = time.perf_counter()
    page.goto(url)
    page.wait_for_selector("#page[data-ready=yes]")
    if live:
        page.wait_for_selector(".panes[data-shown], #live:not(:has(.panes))")
    load = time.perf_counter() - begun
    page.wait_for_timeout(1000)
    axes = page.evaluate(
        "[...document.querySelectorAll('input[data-axis]')].filter((s) => !s.disabled).map((s) => [s.dataset.axis, "
        "Number(s.max)])"
    )
    steps = []
    for number in range(STEPS if axes else 0):
        axis, last = axes[number % len(axes)]
        steps.append(page.evaluate(STEP, [axis, (number * 3 + 1) % (last + 1), live]))
        page.wait_for_timeout(50)
    page.close()
    return load, steps, len(requests)


if __name__ == "__main__":
    main()
