"""Segments that start from light of many bands: filtered and summed band by band, or projected onto few planes first.

In:  a ``Job`` that stands directly behind the segment's input, with the stages in between.
Out: its arrays; what is large comes as bands to be made.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from etendue.physics.light import expansion, sampling
from etendue.plan.model import CellRef
from etendue.run.bands import Banded, in_order
from etendue.run.jobs import Job
from etendue.run.tables import TABLES, asked_transfer, asked_weights, prepared_of
from etendue.spec.capabilities import Summed, ends_in_sum
from etendue.spec.grid import Grid
from etendue.spec.stage import Stage

TOGETHER = 4  # bands projected in one product


@dataclass(eq=False)
class JoinedTransfer:
    """The product of the transfer functions of some stages, one band at a time."""

    stages: tuple[Stage, ...]
    grid: Grid
    precision: str

    @cached_property
    def _prepared(self) -> list[Any]:
        return [prepared_of(stage, {"irradiance": self.grid}, {}) for stage in self.stages]

    @cached_property
    def _rows(self) -> Any:
        return sampling.frequencies(self.grid.line("y").size, self.grid.line("y").step, half=False)

    @cached_property
    def _columns(self) -> Any:
        return sampling.frequencies(self.grid.line("x").size, self.grid.line("x").step, half=True)

    def _product(self, fy: Any, fx: Any, wavelength: Any) -> Any:
        product = np.ones((wavelength.size, 1, 1))
        for stage, prepared in zip(self.stages, self._prepared, strict=True):
            product = product * asked_transfer(stage, fy, fx, wavelength, prepared)
        return product

    @cached_property
    def wavelengths(self) -> Any:
        return np.array(self.grid.bands().values())[:, None, None] * 1e-3

    @cached_property
    def plane(self) -> Any:
        """Radial look-up, where every stage depends on the radial frequency alone; else None."""
        if all(stage.radial for stage in self.stages):
            y, x = self.grid.line("y"), self.grid.line("x")
            key = ("radial plane", y.size, y.step, x.size, x.step, self.precision)
            return TABLES.get(key, lambda: expansion.RadialPlane(self._rows, self._columns, self.precision))
        return None

    @cached_property
    def table(self) -> Any:
        """(wavelength, node): the product on the radial nodes."""
        return self.along(self.plane.nodes)

    def along(self, frequency: Any) -> Any:
        """(wavelength, frequency): the product along x."""
        found = self._product(np.zeros((1, 1)), frequency[None, :], self.wavelengths)[:, 0]
        return np.broadcast_to(found, (self.wavelengths.size, frequency.size))

    def apply(self, half_spectrum: Any, band: int) -> None:
        """Multiply the spectrum of one band, in place."""
        if not self.stages:
            return
        if self.plane is not None:
            self.plane.multiply(half_spectrum, self.table[band])
        else:
            own = self._product(self._rows[:, None], self._columns[None, :], self.wavelengths[band : band + 1])[0]
            half_spectrum *= own.astype(np.result_type(half_spectrum.real if own.dtype.kind == "f" else half_spectrum), copy=False)

    def gathered(self, weights: Any, basis: Any, half_spectra: Any) -> Any:
        """(channel, Ny, Nh): sum_k u_ck(f) S_k over the spectra of the gathered planes."""
        one_by_one = expansion.coefficients(weights, basis, np.eye(weights.shape[1]))
        sums: Any = None
        tables = None if self.plane is None or not self.stages else expansion.coefficients(weights, basis, self.table)
        for number, spectrum in enumerate(half_spectra):
            if sums is None:
                sums = np.zeros((weights.shape[0], *spectrum.shape), dtype=spectrum.dtype)
            for channel, own in enumerate(sums):
                if tables is not None:
                    self.plane.add_product(own, spectrum, tables[channel, number])
                else:
                    own += spectrum * self._mixed(one_by_one[channel, number]).astype(spectrum.dtype)
        return sums

    def _mixed(self, factors: Any) -> Any:
        """sum_l factors[l] T_l(f) on the frequencies of the transform."""
        total: Any = np.zeros((1, 1))
        for band, factor in enumerate(factors):
            own = self._product(self._rows[:, None], self._columns[None, :], self.wavelengths[band : band + 1])[0]
            total = total + factor * own
        return total


@dataclass(eq=False)
class FilteredBands(Banded):
    """Light behind some transfer functions, one band at a time."""

    light: Any
    joined: JoinedTransfer

    def __post_init__(self) -> None:
        self.shape = self.light.shape
        self.dtype = self.light.dtype

    def __getitem__(self, band: int) -> Any:
        half = sampling.spectrum(np.asarray(self.light[band]))
        self.joined.apply(half, band)
        return sampling.planes_of(half, *self.shape[1:])


def from_bands(job: Job, results: Mapping[CellRef, Any]) -> dict[str, Any]:
    """The arrays of a transfer stage, from the segment's input and every transfer function since."""
    port, ref, variable = job.inputs[0]
    light, grid = results[ref].arrays[variable], job.input_grids[port]
    (name,) = job.writes
    assert job.joined is not None
    if not ends_in_sum(type(job.stage)):
        stages = (*job.joined, *(() if job.left_out else (job.stage,)))
        return {name: FilteredBands(light, JoinedTransfer(stages, grid, job.precision)) if stages else light}
    prepared = prepared_of(job.stage, job.input_grids, job.grids)
    weights = asked_weights(job.stage, prepared).astype(float)
    joined = JoinedTransfer(job.joined, grid, job.precision)
    terms = job.stage.terms() if isinstance(job.stage, Summed) else 0
    channels = _expanded(job, light, joined, weights, terms) if 0 < terms < light.shape[0] else _exact(light, joined, weights)
    y, x = grid.line("y"), grid.line("x")
    fy = sampling.frequencies(y.size, y.step, half=False)[:, None]
    fx = sampling.frequencies(x.size, x.step, half=True)[None, :]
    aperture = asked_transfer(job.stage, fy, fx, joined.wavelengths, prepared)
    if aperture.ndim == 3 and aperture.shape[0] > 1:
        raise ValueError(f"{type(job.stage).__name__} has a transfer function of its own for every band; put it in front of the sum")
    aperture = aperture.reshape(aperture.shape[-2:]).astype(np.result_type(channels.real if aperture.dtype.kind == "f" else channels))
    out, where = job.grids[name], []
    for dim, line in (("y", y), ("x", x)):
        start, step = out.line(dim).um()
        where.append(((start - line.start) / line.step, step / line.step, out.line(dim).size))
    planes = np.empty((channels.shape[0], where[0][2], where[1][2]), dtype=job.precision)
    for channel, half in enumerate(channels):
        half *= aperture
        planes[channel] = sampling.sample(half, y.size, x.size, where[0], where[1])
    return {name: planes}


def _exact(light: Any, joined: JoinedTransfer, weights: Any) -> Any:
    """Every band its own transform and transfer function; the sum is taken in frequency."""
    sums: Any = None
    for band, plane in enumerate(in_order(light)):
        half = sampling.spectrum(np.asarray(plane))
        joined.apply(half, band)
        if sums is None:
            sums = np.zeros((weights.shape[0], *half.shape), dtype=half.dtype)
        expansion.add_weighted(sums, weights[:, band], half)
    return sums


def _expanded(job: Job, light: Any, joined: JoinedTransfer, weights: Any, terms: int) -> Any:
    """Few planes, each a sum over wavelength taken before its transform; every channel is a mixture of them."""
    highest = 0.5 * math.hypot(1 / joined.grid.line("y").step, 1 / joined.grid.line("x").step)
    frequency = np.linspace(0.0, highest, expansion.FITTED)
    passed = job.stage.passed(frequency)
    basis = expansion.wavelength_basis(weights, terms, joined.along(frequency), passed)
    planes = np.zeros((basis.shape[0], *light.shape[1:]), dtype=light.dtype)
    group: list[Any] = []
    for band, plane in enumerate(in_order(light)):
        group.append(np.asarray(plane))
        if len(group) == TOGETHER or band + 1 == light.shape[0]:
            expansion.add_projected(planes, basis[:, band + 1 - len(group) : band + 1], group)
            group = []
    return joined.gathered(weights, basis, (sampling.spectrum(plane) for plane in planes))
