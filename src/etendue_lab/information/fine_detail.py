"""Response of a camera to fine grey detail on a grey card: contrast and noise by spatial frequency.

In:  a pipeline, the reflectance of its grey card.
Out: charge of each channel, transfer functions of the stages before the mosaic, NEQ up to any of them and in every
     picture.

Frequencies are in cycles/pixel. Detail is grey: its light has the spectrum of the scene's white, so that pixels behind
all filters have the same contrast.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np

from etendue.compute.cell import compute
from etendue.compute.found import with_found
from etendue.compute.jobs import make_jobs
from etendue.compute.joined.segments import Result
from etendue.contract.capabilities import ChannelTransfer, Summed, Transfer, is_seen_as_transfer, moves_light
from etendue.contract.ports import Progress
from etendue.contract.registry import Registry
from etendue.errors import RequestError
from etendue.pipeline.derived import wanting
from etendue.pipeline.file import PipelineFile
from etendue.plan.model import CellRef, Plan, StageVariable
from etendue.plan.planner import make_plan
from etendue.session import Options, collect
from etendue.transfer.products import Product, alone, behind_filters, between, weights
from etendue.types.arrays import Array, FloatArray
from etendue_camera.resolution import information, noise_power
from etendue_camera.roles import Scaled
from etendue_lab.noise.flat_field import MOSAIC, REACH, FlatField, another, followed, in_front_of_grey

CHARGE, CURRENT, LIGHT = "expected_charge", "photocurrent", "photon_rate"
LINEAR = ("rgb_camera", "xyz_scene", "rgb_linear")
SHOT = "shot noise"


class FineDetail(FlatField):
    """A camera viewing a grey card, described by its own parameters."""

    def __init__(
        self, plan: Plan, arrays: dict[CellRef, dict[str, Array]], pipeline: PipelineFile, notes: list[str]
    ) -> None:
        first = next(n for n in plan.nodes if MOSAIC in n.writes and MOSAIC not in {v for _, _, v in n.inputs[0]})
        super().__init__(plan, first, [arrays], notes)
        self.pipeline = pipeline
        if "pixel_pitch" not in plan.shared:
            raise RequestError("the camera has no pixel_pitch: cycles per pixel are undefined", pipeline.file)
        self.pitch = float(plan.shared["pixel_pitch"])
        self.order = list(np.ndindex(self.mask.shape))
        self.channels = tuple(dict.fromkeys(str(c) for c in self.mask.ravel()))
        self._look_at_stages()
        self._look_at_light()

    def _look_at_stages(self) -> None:
        """Collect the stages before the mosaic that have a transfer function."""
        plan = self.plan
        results = {ref: Result(arrays=dict(found)) for ref, found in self.arrays[0].items()}
        front = [n for n in plan.nodes if n.name in self.before and is_seen_as_transfer(n.kind)]
        stages = {n.name: with_found(self.jobs[n.name, ()], results).stage for n in front}
        self.lens = {name: stage for name, stage in stages.items() if isinstance(stage, Transfer)}
        self.moved = {
            name: stage for name, stage in stages.items() if isinstance(stage, ChannelTransfer) and stage.moves_charge()
        }
        self.blurs = (*self.lens, *self.moved)  # stages that reduce contrast before the noise
        pixel = next((n for n in front if n.ends_in_sum), None)
        if pixel is None:
            raise RequestError("the pipeline has no pixel stage: nothing samples the light", self.pipeline.file)
        self.pixel = pixel.name
        beyond = [n.name for n in plan.nodes if n.name in self.before and moves_light(n.kind)]
        if beyond:
            self.notes.append(
                f"{', '.join(beyond)}: ignored, because no single transfer function holds for the whole frame"
            )

    def _look_at_light(self) -> None:
        """Compute the share of each wavelength band in the photoelectrons of each channel."""
        cell, arrays = self.plan.cells[self.pixel, ()], self.arrays[0]
        self.edges = cell.input_grids[cell.inputs[0][0]].bands().edges
        stage = self.lens[self.pixel]
        assert isinstance(stage, Summed)
        own = weights(stage, alone(stage, self.edges))
        light = next(
            (found["white_irradiance"] for found in reversed(list(arrays.values())) if "white_irradiance" in found),
            None,
        )
        self.light = np.ones(own.shape[1]) if light is None or len(light) != own.shape[1] else np.asarray(light, float)
        self.photons, names = own * self.light, [str(v) for v in cell.grids[LIGHT]["channel"].values()]
        self.number = {c: names.index(c) for c in self.channels if c in names}
        self.colours = {c: self.photons[i] / self.photons[i].sum() for c, i in self.number.items()}

    # -- light ------------------------------------------------------------------------------------------------------

    @cached_property
    def electrons(self) -> dict[str, float]:
        """Photoelectrons of a pixel by channel, without dark charge."""
        dark = self.dark
        return {c: e - dark for c, e in self.signal().items()}

    @cached_property
    def dark(self) -> float:
        """Dark charge of a pixel, electron."""
        node = next(
            (n for n in self.plan.nodes if CHARGE in n.writes and CURRENT in {v for _, _, v in n.inputs[0]}), None
        )
        if node is None:
            return 0.0
        results = {ref: Result(arrays=dict(found)) for ref, found in self.arrays[0].items()}
        source = next(s for _, s, v in node.inputs[0] if v == CURRENT)
        found = results[source, ()].arrays
        results[source, ()] = Result(arrays={**found, CURRENT: np.zeros_like(found[CURRENT])})
        made, _ = compute(replace(self.jobs[node.name, ()], expected=True), results)
        return 0.0 if made.failed else float(np.mean(made.arrays[CHARGE]))

    def contrast(self, channel: str, fy: Array, fx: Array, without: Collection[str] = ()) -> FloatArray:
        """Return the transfer function (m, n) of a channel up to the mosaic, without the stages in ``without``."""
        bands = self.band_contrast(fy, fx, [n for n in self.lens if n not in without])
        return self.mean(channel, bands, fy, fx, [n for n in self.moved if n not in without])

    def mean(self, channel: str, bands: Array, fy: Array, fx: Array, moved: Collection[str]) -> FloatArray:
        """Return the transfer function (m, n) of a channel from those of the wavelength bands (wavelength, m, n). The
        stages in ``moved``, which move charge between pixels, are included.
        """
        if not moved:
            return np.tensordot(self.colours[channel], bands, 1)
        zero = np.zeros(1)
        made, still = (
            [between(self.moved[n], y, x, self.light, alone(self.moved[n], self.edges)) for n in moved]
            for y, x in ((np.asarray(fy) / self.pitch, np.asarray(fx) / self.pitch), (zero, zero))
        )
        found = behind_filters(bands, self.photons, made, [one[..., 0, 0] for one in still])[self.number[channel]]
        return np.asarray(found)

    def band_contrast(self, fy: Array, fx: Array, names: Collection[str]) -> Array:
        """Return the product (wavelength, m, n) of the transfer functions of some stages."""
        product = Product(tuple(self.lens[name] for name in names), self.edges)
        found = product.at(np.asarray(fy)[:, None] / self.pitch, np.asarray(fx)[None, :] / self.pitch)
        return np.broadcast_to(found, (len(self.edges) - 1, len(fy), len(fx)))

    # -- noise ------------------------------------------------------------------------------------------------------

    def variances(self, channel: str, without: Collection[str] = ()) -> float:
        """Return the variance of a pixel, electron^2: shot noise of its light, and all noise stages that are not in
        ``without``.
        """
        light = self.electrons[channel]
        return light + sum(v for name, v in self.added(channel).items() if name not in without)

    def added(self, channel: str) -> dict[str, float]:
        """Return the variance (electron^2) that each stage adds to the shot noise of the light. A stage of shot noise
        adds only the shot noise of the dark charge.
        """
        charge, light = self.signal()[channel], self.electrons[channel]
        return {
            name: max(0.0, stage.variance(charge) - (light if stage.role == SHOT else 0.0))
            for name, stage in self.noisy().items()
        }

    def quanta(self, fy: Array, fx: Array, without: Collection[str] = ()) -> Array:
        """Return the NEQ (m, n) of the mosaic, in quanta per pixel: all pixels together, each with the noise of its
        channel.

        It is the mean NEQ over the positions of the mosaic cell, because the ideal observer knows the filter of every
        pixel. ``without``: stages whose blur or noise is ignored.
        """
        total = np.zeros((len(fy), len(fx)))
        for channel in self.channels:
            share = float(np.mean(self.mask == channel))
            signal = self.electrons[channel] * self.contrast(channel, fy, fx, without)
            total += share * information.neq(signal, self.variances(channel, without))
        return total

    def quanta_of(self, channel: str, fy: Any, fx: Any) -> Array:
        """Return the (m, n) NEQ of the pixels of one channel, in quanta per pixel of the frame."""
        share = float(np.mean(self.mask == channel))
        return share * information.neq(
            self.electrons[channel] * self.contrast(channel, fy, fx), self.variances(channel)
        )

    # -- pictures ---------------------------------------------------------------------------------------------------

    @cached_property
    def full(self) -> float:
        """Charge (electron) of a pixel whose linear mosaic value is 1."""
        scale = self.before[self.first.name]
        assert isinstance(scale, Scaled)
        return scale.electrons()

    @cached_property
    def answers(self) -> dict[StageVariable, list[tuple[Array, Array, float]]]:
        """Responses to a step of one pixel by picture, with variances and weight, at several places of the frame; see
        `FlatField.responses`.
        """
        return self.responses(self.flat_mosaic([self.window(self.arrays[0][self.ref][MOSAIC])]), {}, True)

    def sites(self, shape: tuple[int, ...]) -> Array:
        """Return (place, 2): the row and column of the stepped pixel in each response window."""
        corner = [shape[i] - (REACH + 4) for i in (-2, -1)]  # windows may be cut at the near border, not at the far one
        return np.array([[corner[0] + y, corner[1] + x] for y, x in self.order])

    def signal_in(self, picture: StageVariable, fy: Array, fx: Array, dark: bool = False) -> FloatArray:
        """Return the mean of a picture times the transfer function of grey detail, (channel, m, n). With ``dark``,
        return only the mean, including dark charge.
        """
        before = {c: self.contrast(c, fy, fx) for c in self.channels}
        level = {c: (self.signal()[c] if dark else self.electrons[c]) / self.full for c in self.channels}
        places = np.stack([level[str(self.mask[p])] * before[str(self.mask[p])] for p in self.order])
        total: Any = 0.0
        for responses, _, weight in self.answers[picture]:
            total = total + weight * noise_power.carried_signal(
                noise_power.spectra(responses, self.sites(responses.shape), fy, fx), places
            )
        return np.asarray(total)

    def noise_in(self, picture: StageVariable, fy: Array, fx: Array) -> FloatArray:
        """Return (channel, channel, m, n): cross power spectra of a picture's noise."""
        total: Any = 0.0
        for responses, variance, weight in self.answers[picture]:
            found = noise_power.spectra(responses, self.sites(responses.shape), fy, fx)
            total = total + weight * noise_power.carried_power(found, variance)
        return np.asarray(total)

    def names_of(self, picture: StageVariable) -> tuple[str, ...]:
        return tuple(str(v) for v in self.plan.cells[picture[0], ()].grids[picture[1]]["channel"].values())


def fine_detail(
    pipeline: PipelineFile,
    registry: Registry,
    reflectance: float,
    options: Options | None = None,
    progress: Callable[[Plan], Progress] | None = None,
    notes: list[str] | None = None,
) -> FineDetail:
    """Run a camera that views a grey card once; the sweep of its pipeline is ignored.

    Raises
    ------
    RequestError
        The pipeline is invalid; the camera has no mosaic, no noise, or a stage that does not declare its noise; the
        picture is too small; there is no light.
    """
    if not 0 < reflectance <= 1:
        raise RequestError(f"--reflectance {reflectance:g}: must be greater than 0 and at most 1")
    notes = [] if notes is None else notes
    flat = in_front_of_grey(pipeline, registry, reflectance)
    plan = make_plan(wanting(flat), registry, leave_out_allowed=False)
    notes += [note for note in plan.warnings if note not in notes]
    chosen = followed(plan, notes, "detail", pipeline.file)
    wanted = (*chosen, MOSAIC, CHARGE)
    places = [(n.name, v) for n in plan.nodes for v in n.writes if v in wanted and not n.is_probe]
    plan = make_plan(wanting(flat, places, exact=True), registry, leave_out_allowed=False)
    found = collect(plan, small(plan), options, progress(plan) if progress else None)
    failed = next((r for r in found.reports.values() if r.status == "failed"), None)
    if failed is not None:
        raise RequestError(f"stage {failed.stage!r} failed: {failed.message.splitlines()[-1]}", pipeline.file)
    made = FineDetail(plan, found.arrays, flat, notes)
    if made.unsaid():
        raise RequestError(f"{made.unsaid()}: the noise of its pictures cannot be predicted", pipeline.file)
    if not all(np.isfinite(v) and v > 0 for v in made.electrons.values()):
        raise RequestError(
            "no light of the grey card reaches the pixels: give the scene more light, or the camera more time",
            pipeline.file,
        )
    if float(np.mean(made.window(found.arrays[made.ref][MOSAIC]) >= 0.999)) > 0.001:
        notes.append("pixels of the grey card saturate: their noise is clipped, which the prediction does not include")
    return made


def small(plan: Plan) -> Mapping[CellRef, tuple[str, ...]]:
    """Return the variables to keep, by cell: all except spectral pictures (wavelength, y)."""
    return {
        (n.name, ()): own
        for n in plan.nodes
        if (own := tuple(v for v, d in n.writes.items() if not {"wavelength", "y"} <= set(d.dims))) and not n.is_probe
    }


def frames(
    detail: FineDetail, registry: Registry, count: int, expected: Collection[str] = ()
) -> list[dict[StageVariable, Any]]:
    """Return the mosaic and the linear pictures of noise frames, cut to the window. All frames have the same light;
    each has its own noise and fixed patterns.

    ``expected``: stages that return expected values instead of random draws or rounded values.
    """
    plan = detail.plan
    drawn: set[str] = set()
    for node in plan.nodes:
        if not node.is_probe and (node.is_random or {s for _, s, _ in node.inputs[0]} & drawn):
            drawn.add(node.name)
    wanted = (MOSAIC, *LINEAR)
    found = []
    for number in range(count):
        own = make_plan(another(plan.pipeline, number), registry, leave_out_allowed=False)
        jobs = make_jobs(own, set(own.cells), lambda cell: None, deliver_all=True)
        results = {ref: Result(arrays=dict(a)) for ref, a in detail.arrays[0].items()}
        for node in own.nodes:
            ref: CellRef = (node.name, ())
            if node.name not in drawn or ref not in jobs:
                continue
            results[ref], report = compute(replace(jobs[ref], expected=node.name in expected), results)
            if report.status == "failed":
                raise RequestError(
                    f"stage {node.name!r} failed: {report.message.splitlines()[-1]}", detail.pipeline.file
                )
        found.append(
            {
                (name, v): detail.window(results[name, ()].arrays[v]).astype(np.float64)
                for name in (n.name for n in own.nodes if n.name in drawn and (n.name, ()) in jobs)
                for v in wanted
                if v in results[name, ()].arrays
            }
        )
    return found
