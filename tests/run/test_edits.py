"""Code that is edited between two runs of one archive: what it reaches is computed again and says why, all else is
reused.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.plan.layouts import LAYOUTS, named
from tests.plan.test_code import copied
from tests.run.small import BARE, command

TITLES = (
    "modules without a package",
    "a namespace package",
    "a base class of another distribution",
    "kernels beside the manifest",
)
STAGES = {f"added{n}": LAYOUTS[title] for n, title in enumerate(TITLES)}
MANIFEST = """
from etendue.api import hookimpl

@hookimpl
def etendue_stages():
    return {stages}
"""


def edit(path, old="VALUE = 1.0", new="VALUE = 2.0"):
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    os.utime(path, (path.stat().st_mtime + 10,) * 2)  # bytecode is told from its source by the second


@pytest.fixture
def camera(tmp_path):
    """Runs a camera with four stages of plugins, on a copy of the package: what it says of itself. Its folder of the
    path.
    """
    path = tmp_path / "path"
    copied(path, bytecode=True)  # it is told from its source by time and size
    for n, layout in enumerate(STAGES.values()):
        layout.written(str(n), path)
    places = {name: f"{named(layout.module, str(n))}:Added" for n, (name, layout) in enumerate(STAGES.items())}
    (path / "own_manifest.py").write_text(MANIFEST.format(stages=places))
    (path / "own-1.0.dist-info").mkdir()
    (path / "own-1.0.dist-info" / "METADATA").write_text("Metadata-Version: 2.1\nName: own\nVersion: 1.0\n")
    (path / "own-1.0.dist-info" / "entry_points.txt").write_text("[etendue]\nown = own_manifest\n")
    (tmp_path / "camera.toml").write_text(BARE + "".join(f'[[stages]]\nuse = "{name}"\n' for name in STAGES))

    def run():
        asked = ("run", tmp_path / "camera.toml", "--archive", tmp_path / "archive", "--scheduler", "serial", "--json")
        done = command(*asked, PYTHONPATH=str(path), ETENDUE_CACHE=str(tmp_path / "cache"))
        assert done.returncode == 0, done.stderr
        found = json.loads(done.stdout)
        return found["computed"], found["reused"], found["reasons"]

    return run, path


def test_an_edit_computes_again_what_it_reaches_and_says_why(camera):
    run, path = camera
    cells, reused, _ = run()
    assert reused == 0
    for n, layout in enumerate(STAGES.values()):
        for apart in layout.apart:
            edit(path / named(apart, str(n)))
    for name in (
        "present/terminal/tables.py",
        "cli/runs.py",
        "archive/write/store.py",
        "session.py",
        "plan/wiring/graph.py",
    ):
        edit(path / "etendue" / name, "\n\n\n", "\n\nEDITED = 2.0\n\n")
    assert run() == (0, cells, {})
    kernels = [named(next(reversed(layout.edits)), str(n)) for n, layout in enumerate(STAGES.values())]
    for kernel in kernels:
        edit(
            path / kernel,
            *(() if "VALUE = 1.0" in (path / kernel).read_text() else ("kernel.VALUE", "kernel.VALUE * 2")),
        )
    modules = [named(next(reversed(layout.edits.values())), str(n)) for n, layout in enumerate(STAGES.values())]
    behind = {name: f"its code has changed: {module}" for name, module in zip(STAGES, modules, strict=True)}
    assert run() == (len(STAGES), cells - len(STAGES), behind)
    edit(
        path / "etendue" / "compute" / "joined" / "segments.py",
        "transform = _times(transform, otf)",
        "transform = 0.5 * _times(transform, otf)",
    )
    computed, reused, reasons = run()
    assert (computed, reused) == (cells, 0)
    assert set(reasons.values()) == {"its code has changed: etendue.compute.joined.segments"} and len(reasons) == cells


@pytest.mark.long
def test_operators_and_literals_drawn_from_the_engines_list_are_seen_and_those_of_reports_are_not():
    program = Path(__file__).parents[2] / "benchmarks" / "edits.py"
    done = subprocess.run(
        [sys.executable, str(program), "--seed", "5"], capture_output=True, text=True, check=False, timeout=590
    )
    assert done.returncode == 0, done.stdout + done.stderr
