"""What computing a cell imports and reads is in its key, or on a list of what only moves bytes.

In fresh processes, each for a kind of pipeline.

A process that computes cells and does nothing else says which modules of the package it holds, and which of its files
it has opened.
"""

from __future__ import annotations

import json
import os
from importlib.metadata import EntryPoint
from pathlib import Path

import cloudpickle
import pytest

from etendue.compute import rows as strips
from etendue.compute.jobs import make_jobs
from etendue.contract.capabilities import is_transfer
from etendue.contract.registry import Registry
from etendue.contract.stage import files_of
from etendue.plan import cost
from etendue.plan.identity import code
from etendue.plan.identity.engine import ENGINE, HELD, MOVES, TRANSFER_KERNELS
from etendue.plan.planner import make_plan
from etendue.plugins.discovery import Discovery, installed
from etendue.plugins.hookspecs import GROUP
from etendue.session import load
from tests.fresh import process
from tests.run.small import BARE, environment
from tests.run.test_strips import COLOUR

COMPUTE = """
import json, pickle, sys

opened = set()
sys.addaudithook(lambda event, given: opened.add(str(given[0])) if event == "open" else None)
with open(sys.argv[1], "rb") as file:
    jobs = pickle.load(file)
from etendue.run.batches import run_batch

reports = run_batch(tuple(jobs), {}, (), frozenset()).reports
modules = [name for name in sys.modules if name.partition(".")[0] in ("etendue", "etendue_camera", "etendue_lab")]
print(json.dumps({"status": [r.status + r.message for r in reports], "modules": modules, "opened": sorted(opened)}))
"""
LABELLED = """
from dataclasses import dataclass
from etendue.api import Stage, hookimpl, labelled

@labelled
@dataclass(frozen=True, kw_only=True)
class OnLabels(Stage):
    reads = writes = {"rgb_camera": "channel y x [1]"}
    nan = negative = "keep"

    def run(self, data):
        return data * 2

@hookimpl
def etendue_stages():
    return {"on_labels": OnLabels}
"""
FRAMES = """
[[stages]]
use = "meter"
[[stages]]
use = "bracket"
brackets = [-1, 1]
"""
PATTERNS = """
[[stages]]
use = "defects"
[[stages]]
use = "shot_noise"
[[stages]]
use = "line_pattern"
"""
PACKAGES = os.path.dirname(code.__file__).removesuffix(os.path.join("etendue", "plan", "identity"))
TABLES = (
    "better",
    "quantities",
    "roles",
    "stages",
    "subjects",
    "variables",
    "shown",
)  # which manifests read: what they say stands in keys
# names only: the file of each packaged sensitivity is in the keys of who takes it
OF_MANIFESTS = {
    *(f"etendue_camera/data/{name}.toml" for name in TABLES),
    "etendue_camera/data/cameras/sensitivities.csv",
}
ONE, SHOT = '[[stages]]\nuse = "exposure"\n', '\n[[stages]]\nuse = "shot_noise"\n'
STREAMED = BARE.replace('[[stages]]\nuse = "light_budget"\n', "")
CELLS = BARE.replace('use = "composite"', 'use = "slanted_edge"\nlight = "cells"')
KINDS = {
    "segments, and a stage on labels": (BARE.replace('use = "sharpen"', 'use = "on_labels"'), {}),
    "streamed bands": (STREAMED, {}),
    "strips": (BARE + COLOUR, {}),
    "frames, what a run finds, random numbers, patterns": (
        BARE.replace(ONE, FRAMES + ONE).replace(SHOT, PATTERNS),
        {"camera.dsnu": 2},
    ),
    "an expansion over wavelength, knobs": (
        BARE,
        {"tolerance": 1e-2, "scene.bin_width": "30 nm", "pixel.wavelength_terms": 4},
    ),
    "means over cells of the scene": (CELLS, {}),
    "means in the place of draws": (BARE, {"camera.dsnu": 2}),
}
LONG = [pytest.param(kind, marks=pytest.mark.long) for kind in [*KINDS][4:]]


def computed(plan, folder, **more):
    """What a process that computes all cells of a plan says of itself; of axes the first values only."""
    jobs = make_jobs(plan, set(plan.cells), lambda cell: None, deliver_all=True)
    first = [jobs[ref] for ref in jobs if not any(ref[1])]
    (folder / "jobs").write_bytes(cloudpickle.dumps(first))
    done = process(folder / "jobs", code=COMPUTE, env=environment(**more))
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout.splitlines()[-1])
    assert set(found["status"]) <= {"done", "left_out"}, found["status"]
    return found


def unlisted(plan, found):
    """Modules and files of the package that are in no key of the plan's cells, and in no list."""
    kinds = [one.kind for node in plan.nodes for one in node.alternatives]
    behind = set().union(*(code.code_of(kind).sources for kind in kinds))
    idle = ["etendue.api.labelled"]  # imported with the door, in the keys of those who take it
    idle += () if any(map(is_transfer, kinds)) else TRANSFER_KERNELS
    handed, listed = set(code._reached(idle).sources), {*ENGINE, *MOVES, *HELD, *code.manifests()}
    modules = {
        name
        for name in found["modules"]
        if not (name in behind or name in listed or name in handed or _only_words(name))
    }
    opened = {path.removeprefix(PACKAGES) for path in found["opened"] if path.startswith(PACKAGES)}
    files = {name for name in opened if not name.endswith((".py", ".pyc", "/")) and os.path.isfile(PACKAGES + name)}
    handed_in = {path.removeprefix(PACKAGES) for cell in plan.cells.values() for path in files_of(cell.stage).values()}
    return modules | {name for name in files - handed_in if name not in behind and name not in OF_MANIFESTS}


def _only_words(name):
    path = Path(code.__file__).parents[3] / Path(*name.split(".")) / "__init__.py"
    return path.is_file() and code.sources.known(path).words


@pytest.mark.parametrize("kind", [*KINDS][:4] + LONG)
def test_what_a_cell_imports_is_in_its_key_or_only_moves_bytes(kind, tmp_path, monkeypatch):
    text, overrides = KINDS[kind]
    (tmp_path / "on_labels.py").write_text(LABELLED)
    monkeypatch.syspath_prepend(str(tmp_path))
    registry = Registry(Discovery([*installed().points, EntryPoint("own", "on_labels", GROUP)]))
    if kind == "strips":
        for name, value in {"LARGEST_WHOLE": 0, "STRIP": 1, "TILE": 8, "HALOS": 2}.items():
            monkeypatch.setattr(strips, name, value)
    if kind == "streamed bands":
        monkeypatch.setattr(cost, "LARGEST_WHOLE", 1000)
    plan = make_plan(load(text, overrides), registry, expected="draws" in kind)
    found = computed(plan, tmp_path, PYTHONPATH=str(tmp_path))
    assert {"etendue.compute.cell", "etendue.compute.tables", "etendue.transfer.products"} <= set(found["modules"])
    assert not unlisted(plan, found)


@pytest.mark.long
@pytest.mark.parametrize("name", sorted(path.stem for path in (Path(__file__).parents[2] / "pipelines").glob("*.toml")))
def test_so_it_is_for_every_pipeline_that_is_shipped(name, tmp_path):
    registry = Registry(installed())
    pipeline = load(Path(__file__).parents[2] / "pipelines" / f"{name}.toml", {})
    if any(entry.use not in registry for entry in pipeline.stages):
        pytest.skip("needs a plugin that is not installed")
    plan = make_plan(pipeline, registry)
    assert not unlisted(plan, computed(plan, tmp_path))


def test_a_module_that_nobody_has_listed_is_found(tmp_path, monkeypatch):
    """The law fails where it should: a cell that imports what is neither in its key nor on a list."""
    plan = make_plan(load(BARE, {}), Registry(installed()))
    found = {
        "modules": [*ENGINE, "etendue.present.terminal.terminal", "etendue.plan.wiring.graph", "etendue.run.later"],
        "opened": [code.__file__],
    }
    tables = (
        "etendue_lab/data/closed_forms.json",
        "etendue_camera/data/spectra.npz",
        "etendue_camera/data/variables.toml",
    )
    found["opened"] += [PACKAGES + table for table in tables]
    expected = {"etendue.present.terminal.terminal", "etendue.plan.wiring.graph", "etendue.run.later", tables[0]}
    assert unlisted(plan, found) == expected
