"""The widget and the glance in a real JupyterLab: are they drawn, does a slider move the pictures, are pixels the
store's.

    python benchmarks/jupyter.py [ARCHIVE] [-o shot.png] [--chromium /usr/bin/chromium] [--height 900]

Without an archive pipelines/smallest.toml is run first. A JupyterLab of this Python is started on a free port of
127.0.0.1 with a token, its folders below a temporary one; headless Chromium opens a notebook of two cells,
``etendue.open_archive(...).etendue`` and ``etendue.present.page.notebook.view(...)``, and runs them. Printed is a row
for each step, with its time and what was seen; the exit code is 1 where something is not as it should be. Kernel and
server are ended, and it is said whether any of them is left. Needs jupyterlab, ``etendue[view]``, playwright and a
Chromium.
"""

from __future__ import annotations

import argparse
import json
import os
import secrets
import signal
import subprocess
import sys
import tempfile
import time
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.metadata import version
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import numpy as np
import xarray
from plain import HERE, plan_of

FLAGS = ["--no-sandbox", "--disable-gpu", "--disable-background-networking", "--disable-dev-shm-usage"]
WAIT = 120_000  # ms: a loaded machine is slow, not wrong
PATIENCE = 90.0  # seconds for the server to begin, and to end
SLIDE = """([axis, place]) => {
  const slider = document.querySelector(`input[data-axis=${axis}]`);
  slider.value = place; slider.dispatchEvent(new Event('input')); return performance.now(); }"""
COLOURS = """() => {  // how many colours the first picture has: one that is not drawn has one
  const c = document.querySelector('.pixels'), seen = new Set(),
    d = c.getContext('2d').getImageData(0, 0, c.width, c.height).data;
  for (let i = 0; i < d.length; i += 4) seen.add(d[i] * 65536 + d[i + 1] * 256 + d[i + 2]);
  return seen.size; }"""


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("archive", nargs="?", type=Path)
    parser.add_argument("-o", "--output", type=Path, help="a screenshot of the notebook")
    parser.add_argument("--chromium", default="/usr/bin/chromium")
    parser.add_argument("--height", type=int, default=900, help="of the widget, in pixels")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        archive = (given.archive or made(place / "smallest")).absolute()
        notebook(place / "shown.ipynb", str(archive) if given.archive else archive.name, given.height)
        rows = Rows()
        with server(place) as (url, token, process):
            rows.say("JupyterLab answers", "", f"jupyterlab {version('jupyterlab')}, anywidget {version('anywidget')}")
            kernels = looked_at(rows, url, token, archive, given.chromium, given.output)
        left = [pid for pid in [*kernels, process] if alive(pid)]
        rows.say("processes left", len(left) == 0, f"{len(left)} of {1 + len(kernels)}")
    return 0 if rows.right else 1


class Rows:
    """What was done, how long it took since the row before, and what was seen."""

    def __init__(self) -> None:
        self.right, self.began = True, time.perf_counter()
        print(f"{'step':<34}{'seconds':>8}  {'':<6}seen")

    def say(self, step: str, right: Any, seen: str = "") -> None:
        now = time.perf_counter()
        self.right = self.right and right is not False
        print(
            f"{step:<34}{now - self.began:8.2f}  {'' if right == '' else 'ok' if right else 'WRONG':<6}{seen}",
            flush=True,
        )
        self.began = time.perf_counter()


def made(folder: Path) -> Path:
    from etendue.session import Options, execute

    execute(plan_of(HERE.parent / "pipelines" / "smallest.toml"), folder, Options())
    return folder


def notebook(path: Path, archive: str, height: int) -> None:
    cells = [
        f"import etendue, os\nprint('kernel', os.getpid())\netendue.open_archive({archive!r}).etendue",
        f"from etendue.present.page.notebook import view\nview({archive!r}, height={height})",
    ]
    made = [
        {"cell_type": "code", "id": f"cell{n}", "execution_count": None, "metadata": {}, "outputs": [], "source": text}
        for n, text in enumerate(cells)
    ]
    kernel = {"kernelspec": {"display_name": "Python 3", "language": "python", "name": "python3"}}
    path.write_text(
        json.dumps({"cells": made, "metadata": kernel, "nbformat": 4, "nbformat_minor": 5}), encoding="utf-8"
    )


@contextmanager
def server(place: Path) -> Iterator[tuple[str, str, int]]:
    """A JupyterLab below a folder: its address, its token, its process, which is ended."""
    token = secrets.token_urlsafe(24)
    own = {
        "JUPYTER_RUNTIME_DIR": "runtime",
        "JUPYTER_CONFIG_DIR": "config",
        "JUPYTER_DATA_DIR": "data",
        "IPYTHONDIR": "ipython",
        "JUPYTERLAB_SETTINGS_DIR": "settings",
    }
    silent = place / "settings/@jupyterlab/apputils-extension/notification.jupyterlab-settings"
    silent.parent.mkdir(parents=True)
    silent.write_text(json.dumps({"fetchNews": "false", "checkForUpdates": False}))
    environment = {**os.environ, **{name: str(place / folder) for name, folder in own.items()}, "JUPYTER_TOKEN": token}
    command = [
        sys.executable,
        "-m",
        "jupyterlab",
        "--no-browser",
        "--allow-root",
        "--ServerApp.ip=127.0.0.1",
        "--ServerApp.port=0",
        f"--ServerApp.root_dir={place}",
        "--expose-app-in-browser",
        "--LabApp.extension_manager=readonly",
        "--LabApp.check_for_updates_class=jupyterlab.NeverCheckForUpdate",
    ]
    with open(place / "server.log", "w") as log:
        process = subprocess.Popen(
            command, env=environment, cwd=place, stdout=log, stderr=subprocess.STDOUT, start_new_session=True
        )
    try:
        yield address(place, process), token, process.pid
    finally:
        process.send_signal(signal.SIGTERM)  # it ends its kernels
        try:
            process.wait(PATIENCE)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


def address(place: Path, process: subprocess.Popen[bytes]) -> str:
    """Where the server listens, from the file that it writes when it does."""
    until = time.monotonic() + PATIENCE
    while time.monotonic() < until and process.poll() is None:
        for file in (place / "runtime").glob("jpserver-*.json"):
            try:
                return str(json.loads(file.read_text())["url"])
            except (ValueError, KeyError):
                continue
        time.sleep(0.1)
    raise SystemExit(f"JupyterLab did not begin:\n{(place / 'server.log').read_text()[-2000:]}")


def alive(pid: int) -> bool:
    try:
        return "Z" not in Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except OSError:
        return False


def looked_at(rows: Rows, url: str, token: str, archive: Path, chromium: str, output: Path | None) -> list[int]:
    from playwright.sync_api import sync_playwright

    asked: list[str] = []
    complaints: list[str] = []
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium, args=FLAGS, timeout=WAIT)
        page = browser.new_page(viewport={"width": 1500, "height": 2300})
        page.set_default_timeout(WAIT)
        page.on("request", lambda request: asked.append(request.url))
        page.on("pageerror", lambda error: complaints.append(str(error)))
        page.goto(f"{url}lab/tree/shown.ipynb?token={token}")
        page.wait_for_function("window.jupyterapp && document.querySelectorAll('.jp-CodeCell').length === 2")
        page.get_by_text("Python 3 (ipykernel) | Idle").wait_for()
        page.evaluate("() => window.jupyterapp.commands.execute('application:toggle-left-area')")
        rows.say("the notebook is open", "")
        page.evaluate("() => { window.jupyterapp.commands.execute('notebook:run-all-cells'); }")
        page.wait_for_selector(".jp-OutputArea .etendue img")
        pictures = page.locator(".jp-OutputArea .etendue img")
        page.wait_for_function(
            "[...document.querySelectorAll('.jp-OutputArea .etendue img')].every((one) => one.complete && "
            "one.naturalWidth > 0)"
        )
        rows.say("tree.etendue is drawn", pictures.count() > 0, f"{pictures.count()} pictures")
        kernel = int(page.locator(".jp-OutputArea-output pre", has_text="kernel ").first.inner_text().split()[1])
        page.wait_for_selector("iframe[title=etendue]")
        frame = next(
            one for one in page.frames if one.parent_frame and one.frame_element().get_attribute("title") == "etendue"
        )
        frame.wait_for_selector(".panes[data-shown]")
        frame.wait_for_timeout(500)
        colours = frame.evaluate(COLOURS)
        rows.say("the widget's picture is drawn", colours > 16, f"{colours} colours")
        frame.get_by_role("combobox", name="picture").first.select_option(label="encode: RGB display")
        axes = axis_values(archive)
        begun = time.perf_counter()
        first, places = next(iter(axes)), {}
        for axis, values in axes.items():
            places[axis] = len(values) - 1
            frame.evaluate(SLIDE, [axis, places[axis]])
        frame.wait_for_selector(",".join([f".panes[data-shown*='{first}:{places[first]}']"]))
        rows.say("sliders move the pictures", "", f"to {places}, {1e3 * (time.perf_counter() - begun):.0f} ms for all")
        row, column, told = pointed_at(page, frame)
        stored = values_at(archive, {axis: axes[axis][place] for axis, place in places.items()})[:, row, column]
        same = told == stored.astype(float).tolist()
        rows.say("a pixel equals the store", same, f"row {row}, column {column}: {', '.join(f'{v:.4f}' for v in told)}")
        outside = [
            one
            for one in asked
            if urlsplit(one).scheme in ("http", "https", "ws", "wss") and urlsplit(one).hostname != "127.0.0.1"
        ]
        rows.say(
            "requests that leave the machine",
            not outside,
            f"{len(outside)} of {len(asked)} {' '.join(outside[:3])}".rstrip(),
        )
        rows.say("errors of the page", not complaints, f"{len(complaints)} {' '.join(complaints[:3])}".rstrip())
        if output:
            page.mouse.move(5, 5)
            page.screenshot(path=str(output))
            rows.say("screenshot", "", str(output))
        browser.close()
    ended(url, token)
    rows.say("the kernel is ended", "")
    return [kernel]


def pointed_at(page: Any, frame: Any) -> tuple[int, int, list[float]]:
    """Row, column and values of what stands under the pointer, as the page tells them."""
    canvas = frame.locator(".pixels").first
    canvas.scroll_into_view_if_needed()
    frame.wait_for_timeout(500)
    box = canvas.bounding_box()
    page.mouse.move(box["x"] + 0.4 * box["width"], box["y"] + 0.55 * box["height"])
    told = frame.wait_for_selector("[data-probe='encode.rgb_display'][data-row]")
    return (
        int(told.get_attribute("data-row")),
        int(told.get_attribute("data-column")),
        json.loads(told.get_attribute("data-values")),
    )


def axis_values(archive: Path) -> dict[str, list[float]]:
    from etendue.present.page.opened import Opened

    opened = Opened(archive)
    return {axis.dim: list(axis.values) for axis in opened.axes if axis.dim in opened.reaching("encode")}


def values_at(archive: Path, at: dict[str, float]) -> Any:
    tree = xarray.open_datatree(archive / "data.zarr", engine="zarr")
    for node in tree["encode"].subtree:
        if "rgb_display" in node.data_vars and all(value in node[axis].values for axis, value in at.items()):
            return np.asarray(node["rgb_display"].sel(at))
    raise SystemExit(f"no rgb_display of encode at {at}")


def ended(url: str, token: str) -> None:
    """Every kernel of the server."""
    head = {"Authorization": f"token {token}"}
    with urllib.request.urlopen(urllib.request.Request(f"{url}api/kernels", headers=head), timeout=30) as answer:
        kernels = json.load(answer)
    for one in kernels:
        urllib.request.urlopen(
            urllib.request.Request(f"{url}api/kernels/{one['id']}", headers=head, method="DELETE"), timeout=60
        ).close()


if __name__ == "__main__":
    sys.exit(main())
