"""A whole camera on a small frame, and ways to run it: shared by the tests of run and archive.

32 x 32 pixels, 3 wavelength bands, 2 x 2 x 2 cells, noise on, a demosaicer as an axis, two probes.
"""

from __future__ import annotations

import os
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import xarray

from etendue.contract.registry import installed_stages
from etendue.plan.model import CellRef, Plan
from etendue.plan.planner import make_plan
from etendue.session import Options, Outcome, execute, load
from tests.fresh import process

BARE = """
name = "small"
seed = 3
tolerance = 1e-4

[camera]
peak_qe = [0.36, 0.44, 0.40]
pixel_pitch = "2.6 um"

[[stages]]
use = "composite"
name = "scene"
white_luminance = "1000 cd m-2"
width = "96 um"
height = "96 um"
spacing = "1 um"
wavelength_from = "400 nm"
wavelength_to = "700 nm"
bin_width = "100 nm"

[[stages]]
use = "irradiance"
[[stages]]
use = "falloff"
[[stages]]
use = "diffraction"
[[stages]]
use = "diffusion"
[[stages]]
use = "pixel"
rows = 32
columns = 32
[[stages]]
use = "mosaic"
[[stages]]
use = "exposure"
[[stages]]
use = "shot_noise"
[[stages]]
use = "read_noise"
[[stages]]
use = "adc"
[[stages]]
use = "linearise"
[[stages]]
use = "demosaic_bilinear"
name = "demosaic"
[[stages]]
use = "sharpen"
[[stages]]
use = "exposure_report"
[[stages]]
use = "resolution"
[[stages]]
use = "light_budget"
"""

SWEEP = {
    "sweep.f_number": [2, 5.6],
    "sweep.pixel_pitch": ["2.0 um", "2.6 um"],
    "sweep.integration_time": ["2 ms", "8 ms"],
}
DEMOSAICERS = {"sweep.demosaic.use": ["demosaic_bilinear", "demosaic_nearest"]}


def text_of(**sweep: Any) -> str:
    """The pipeline as a file: axes as given, values as TOML."""
    lines = [f'"{key}" = {value}' for key, value in sweep.items()]
    return BARE + ("\n[sweep]\n" + "\n".join(lines) + "\n" if lines else "")


def plan_of(overrides: dict[str, Any] | None = None, text: str = BARE, leave_out: bool = True) -> Plan:
    return make_plan(load(text, overrides or {}), installed_stages(), leave_out)


def run(plan: Plan, archive: Path | None = None, **options: Any) -> Outcome:
    return execute(plan, archive, Options(**{"scheduler": "serial", **options}))


Labels = tuple[str, tuple[tuple[str, Any], ...]]


def by_labels(
    plan: Plan, arrays: dict[CellRef, dict[str, Any]], every: tuple[str, ...] = ()
) -> dict[tuple[Labels, str], Any]:
    """Arrays by stage, axis values and variable; ``every`` drops axes that only one of two plans has."""
    found = {}
    for ref, own in arrays.items():
        labels = tuple(sorted((d, v) for d, v in plan.labels(ref).items() if d not in every))
        for variable, array in own.items():
            if (ref[0], variable) in plan.kept:
                found[((ref[0], labels), variable)] = array
    return found


def assert_same_bits(first: Any, second: Any, what: Any = "") -> None:
    first, second = np.asarray(first), np.asarray(second)
    assert first.dtype == second.dtype, what
    assert first.shape == second.shape, what
    assert first.tobytes() == second.tobytes(), what


def assert_same_arrays(first: dict[Any, Any], second: dict[Any, Any]) -> None:
    assert first
    assert set(first) == set(second)
    for key, array in first.items():
        assert_same_bits(array, second[key], key)


RUNTIMES = {"seconds"}


def files_of(archive: Path) -> dict[str, bytes]:
    """Every file of the store but measured times: what agrees in them need not be read with xarray."""
    files = (path for path in (archive / "data.zarr").rglob("*") if path.is_file() and path.parts[-3] not in RUNTIMES)
    return {path.relative_to(archive).as_posix(): path.read_bytes() for path in files}


def assert_same_archives(first: Path, second: Path, frames: bool = True) -> None:
    """Every array of two archives has the same dims, attributes and bits; measured times may differ.

    Frames are pictures of what a run saw: of stages that are not kept there is none after a resume.
    """
    here, there = files_of(first), files_of(second)
    changed = [path for path in {*here, *there} if here.get(path) != there.get(path)]
    assert here
    if not changed:
        return
    with (
        xarray.open_datatree(first / "data.zarr", engine="zarr", chunks=None) as one,
        xarray.open_datatree(second / "data.zarr", engine="zarr", chunks=None) as other,
    ):
        assert {n.path for n in one.subtree} == {n.path for n in other.subtree}
        for node in one.subtree:
            if node.path == "/frames" and not frames:
                continue
            twin = other[node.path].dataset
            assert dict(node.dataset.attrs) == dict(twin.attrs), node.path
            assert set(node.dataset.variables) == set(twin.variables), node.path
            for name, variable in node.dataset.variables.items():
                where = f"{node.path}/{name}"
                if name in RUNTIMES or not any(path.startswith(f"data.zarr{where}/") for path in changed):
                    continue
                assert variable.dims == twin[name].dims, where
                assert dict(variable.attrs) == dict(twin[name].attrs), where
                mine, its = np.asarray(variable.values), np.asarray(twin[name].values)
                if mine.dtype.kind in "OT":
                    assert mine.tolist() == its.tolist(), where
                else:
                    assert_same_bits(mine, its, where)


def environment(**more: str) -> dict[str, str]:
    """The environment of a subprocess; ``PYTHONPATH`` stands in front of the one there is."""
    path = [more["PYTHONPATH"]] if "PYTHONPATH" in more else []
    path += [os.environ["PYTHONPATH"]] if "PYTHONPATH" in os.environ else []
    return {**os.environ, **more} | ({"PYTHONPATH": os.pathsep.join(path)} if path else {})


def command(*arguments: Any, **more: str) -> subprocess.CompletedProcess[str]:
    """What ``python -m etendue`` says and leaves behind."""
    return process(*arguments, env=environment(**more))
