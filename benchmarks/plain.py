"""The same camera without the engine: plain loops over the same kernels, for the benchmarks beside it.

``shared`` does every stage once for the axes that reach it, as a careful script would. ``naive`` evaluates one point
from the scene to the display; with ``separate=True`` as a straightforward script does: double precision and a transform
pair for every blur.
"""

from __future__ import annotations

import os
import resource
import time
from pathlib import Path
from typing import Any

import numpy as np

from etendue.compute.random import philox
from etendue.compute.tables import PatternRandom, coordinates_of, prepared_of
from etendue.contract.registry import installed_stages
from etendue.contract.stage import arguments_of
from etendue.pipeline.file import read_pipeline
from etendue.plan.model import Plan
from etendue.plan.planner import make_plan
from etendue.transfer import sampling
from etendue.transfer.products import Product

HERE = Path(__file__).parent
CHAIN = ("full_well", "read_noise", "adc", "linearise", "demosaic", "sharpen")


def plan_of(path: Path, **overrides: Any) -> Plan:
    return make_plan(read_pipeline(path, overrides), installed_stages())


def timed(function: Any, *arguments: Any) -> tuple[float, float, Any]:
    """Wall seconds, CPU seconds of the process, result."""
    wall, cpu = time.perf_counter(), time.process_time()
    result = function(*arguments)
    return time.perf_counter() - wall, time.process_time() - cpu, result


def peak_memory() -> int:
    """Peak resident bytes of this process so far."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


class Camera:
    """The stages of a plan at one point, ready to be called; tables are prepared once per point of their own axes."""

    def __init__(self, plan: Plan) -> None:
        self.plan, self.dtype = plan, np.dtype(plan.precision)
        self.tables: dict[Any, Any] = {}

    def cell(self, name: str, **at: int) -> Any:
        node = self.plan.node(name)
        return self.plan.cells[(name, tuple(at[d] for d in node.axes))]

    def table(self, cell: Any, key: str, make: Any) -> Any:
        known = (key, cell.stage)
        if known not in self.tables:
            self.tables[known] = make()
        return self.tables[known]

    def prepared(self, cell: Any) -> Any:
        return self.table(cell, "prepared", lambda: prepared_of(cell.stage, cell.input_grids, cell.grids))

    def otf(self, cell: Any, dtype: Any) -> Any:
        grid = cell.input_grids["irradiance"]
        y, x = grid.line("y"), grid.line("x")

        def make() -> Any:
            fy = sampling.frequencies(y.size, y.step, half=False)[:, None]
            fx = sampling.frequencies(x.size, x.step, half=True)[None, :]
            return Product((cell.stage,), grid.bands().edges, lambda *_: self.prepared(cell)).at(fy, fx).astype(dtype)

        return self.table(cell, f"otf {dtype}", make)

    # -- the camera in five calls ---------------------------------------------------------------------

    def scene(self, at: dict[str, int]) -> tuple[Any, Any]:
        cell = self.cell("scene", **at)
        where = coordinates_of(cell.grids, "out_")
        asked = {name: where[name] for name in arguments_of(type(cell.stage)) if name in where}
        made = cell.stage.run(**asked, prepared=self.prepared(cell))
        return made["radiance"].astype(self.dtype), made["white_radiance"].astype(self.dtype)

    def run(self, cell: Any, *arrays: Any) -> Any:
        """A stage on its arrays, with the coordinates and tables it asks for."""
        where = self.table(cell, "where", lambda: coordinates_of(cell.grids))
        rest = list(arguments_of(type(cell.stage)))[len(arrays) :]
        return cell.stage.run(
            *arrays, **{name: self.prepared(cell) if name == "prepared" else where[name] for name in rest}
        )

    def light(self, radiance: Any, white: Any, at: dict[str, int]) -> tuple[Any, Any]:
        made = self.cell("irradiance", **at).stage.run(radiance, white)
        lit = self.run(self.cell("falloff", **at), made["irradiance"])["irradiance"]
        return lit, made["white_irradiance"].astype(self.dtype)

    def blurred(self, irradiance: Any, at: dict[str, int]) -> Any:
        spectrum = sampling.transform(irradiance)
        for name in ("lens", "diffusion"):
            spectrum = spectrum * self.otf(self.cell(name, **at), self.dtype)
        return spectrum

    def pixel(self, spectrum: Any, at: dict[str, int]) -> Any:
        cell = self.cell("pixel", **at)
        channels = sampling.sum_over_bands(cell.stage.weights(self.prepared(cell)), spectrum) * self.otf(
            cell, self.dtype
        )
        light, out = cell.input_grids["irradiance"], cell.grids["photon_rate"]
        where = []
        for dim in ("y", "x"):
            line, (start, step) = light.line(dim), out.line(dim).um()
            where.append(((start - line.start) / line.step, step / line.step, out.line(dim).size))
        rate = sampling.sample(channels, light["y"].size, light["x"].size, *where)
        return self.run(self.cell("mosaic", **at), rate)["photocurrent"]

    def develop(self, photocurrent: Any, whites: tuple[Any, Any], at: dict[str, int]) -> Any:
        cell = self.cell("exposure", **at)
        sensor = PatternRandom(b"1", cell.grids["expected_charge"], self.plan.precision)
        charge = cell.stage.run(np.maximum(photocurrent, 0), sensor)["expected_charge"]
        cell = self.cell("shot_noise", **at)
        charge = cell.stage.run(charge, philox(cell.seed))["charge"]
        charge = self.cell("full_well", **at).stage.run(charge)["charge"]
        cell = self.cell("read_noise", **at)
        charge = cell.stage.run(charge, philox(cell.seed), sensor)["charge"]
        raw = self.cell("adc", **at).stage.run(charge)["raw"]
        linearised = self.cell("linearise", **at).stage.run(raw)
        linear, clipped = (linearised[name].astype(self.dtype) for name in ("mosaic_linear", "clipping_level"))
        rgb = self.run(self.cell("demosaic", **at), linear)["rgb_camera"]
        rgb = self.cell("sharpen", **at).stage.run(rgb, [])["rgb_camera"]
        cell = self.cell("white", **at)
        white = cell.stage.run(whites[1], self.prepared(cell))["white"].astype(self.dtype)
        cell = self.cell("colour_fit", **at)
        fit = self.table(cell, f"fit {at['f_number']}", lambda: cell.stage.run(*whites, self.prepared(cell)))
        xyz = self.cell("camera_to_xyz", **at).stage.run(rgb, white, clipped, fit["colour_matrix"].astype(self.dtype))[
            "xyz_scene"
        ]
        cell = self.cell("balance", **at)
        xyz = cell.stage.run(xyz, fit["white_xyz"].astype(self.dtype), self.prepared(cell))["xyz_scene"]
        cell = self.cell("display", **at)
        linear = cell.stage.run(xyz, self.prepared(cell))["rgb_linear"]
        return self.cell("encode", **at).stage.run(linear)["rgb_display"]


def _sizes(plan: Plan) -> list[range]:
    return [range(len(axis.values)) for axis in plan.axes]


def shared(plan: Plan) -> dict[tuple[int, ...], Any]:
    """Three nested loops, every stage once for the axes that reach it."""
    camera = Camera(plan)
    lens, pixel, time_ = (axis.dim for axis in plan.axes)
    results = {}
    radiance, white = camera.scene({})
    for i in _sizes(plan)[0]:
        irradiance, white_irradiance = camera.light(radiance, white, {lens: i})
        spectrum = camera.blurred(irradiance, {lens: i})
        for j in _sizes(plan)[1]:
            photocurrent = camera.pixel(spectrum, {lens: i, pixel: j})
            for k in _sizes(plan)[2]:
                at = {lens: i, pixel: j, time_: k}
                results[(i, j, k)] = camera.develop(photocurrent, (white, white_irradiance), at)
    return results


def naive(plan: Plan, point: tuple[int, ...], separate: bool) -> Any:
    """One point from the scene to the display, sharing nothing with any other."""
    camera = Camera(plan)
    at = {axis.dim: i for axis, i in zip(plan.axes, point, strict=True)}
    if separate:
        camera.dtype = np.dtype(np.float64)
    radiance, white = camera.scene(at)
    irradiance, white_irradiance = camera.light(radiance, white, at)
    if separate:
        ny, nx = irradiance.shape[1:]
        for name in ("lens", "diffusion"):
            otf = camera.otf(camera.cell(name, **at), np.float64)
            irradiance = sampling.planes_of(sampling.transform(irradiance) * otf, ny, nx)
        spectrum = sampling.transform(irradiance)
    else:
        spectrum = camera.blurred(irradiance, at)
    return camera.develop(camera.pixel(spectrum, at), (white, white_irradiance), at)


def machine() -> str:
    return f"{os.cpu_count()} cores, numpy {np.__version__}"
