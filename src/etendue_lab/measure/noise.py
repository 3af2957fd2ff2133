"""Noise of uniform patches in a photograph: in linear light and in the file's own numbers.

In:  a photograph, a region.
Out: a row for each channel: mean, sigma and SNR, each with an interval.
"""

from __future__ import annotations

import math
from dataclasses import asdict

import numpy as np

from etendue.errors import RequestError
from etendue.types.documents import Document
from etendue_camera.quality.patch_noise import PatchNoise, patch_noise
from etendue_lab.measure.photograph import PhotographFile
from etendue_lab.measure.regions import window

CLIPPED = 1e-3  # share of clipped pixels above which a patch is refused
SLOPE = 0.5  # change over the patch, relative to its mean
TIMES = 4.0  # limit of the rms of block means relative to that of independent pixel noise
KEPT = 0.5  # relative to the mean step of a JPEG's table: noise (numbers of the file) below it has been removed
UNEVEN, MOST = 0.02, 0.7  # limits relative to the mean, and to the noise


def measured_noise(photograph: PhotographFile, text: str, confidence: float) -> Document:
    """Measure one patch.

    Raises
    ------
    RequestError
        The region is outside the picture, too small, clipped or not uniform.
    """
    place = window("--noise", text, photograph.columns, photograph.rows)
    what = f"--noise {place}"
    clipped = float(photograph.clipped(place.cut).mean())
    if clipped > CLIPPED:
        raise RequestError(
            f"{what}: {100 * clipped:.1f} % of the patch is clipped, which hides its noise; choose a patch that is "
            "neither "
            f"black nor white"
        )
    luminance = () if photograph.is_raw or len(photograph.names) == 1 else ("luminance",)
    rows, hidden = [], []
    whole = 0.0 if photograph.values.dtype.kind == "f" and not photograph.is_raw else 1.0
    least = math.inf
    for name in (*photograph.names, *luminance):
        plane, sites = photograph.linear(name, place.cut)
        try:
            step = _step(photograph, name, place.cut)
            found = patch_noise(plane, sites, confidence, step=step)
            own = None
            if name != "luminance":
                unit = "DN"
                number = max(photograph.names.index(name), 0) if not photograph.is_raw else 0
                own = patch_noise(photograph.values[place.cut][..., number], sites, confidence, unit, step=whole)
        except ValueError as error:
            raise RequestError(f"{what}: {error}") from None
        _check_even(what, name, found, step)
        hidden += [name] if found.hidden else []
        least = min(least, own.sigma.value if own is not None else math.inf)
        rows.append({"channel": name, "linear": _said(found), "encoded": _said(own) if own is not None else None})
    lost = photograph.lossy and least < KEPT * float(np.mean(photograph.table))
    return {"region": str(place), "clipped": clipped, "channels": rows, "hidden": hidden, "not_covered": bool(lost)}


def _step(photograph: PhotographFile, name: str, cut: tuple[slice, slice]) -> float:
    """Return the step in linear light between neighbouring numbers of a plane, at its mean level. For luminance, return
    the single step whose rounding error equals that of all channels together.
    """
    if name != "luminance":
        return photograph.step(float(photograph.linear(name, cut)[0].mean()))
    steps = [
        w * photograph.step(float(plane.mean()))
        for w, plane in zip(photograph.weights, photograph.planes(cut), strict=True)
    ]
    values = photograph.values[cut]
    same = bool((values == values[..., :1]).all())  # equal channels also have equal rounding errors
    return sum(steps) if same else math.hypot(*steps)


def _check_even(what: str, name: str, found: PatchNoise, step: float) -> None:
    if found.slope > SLOPE:
        raise RequestError(
            f"{what}: the patch is not uniform: {name} changes by {100 * found.slope:.0f} % of its mean over it"
        )
    blocks, noise = found.uneven * abs(found.mean.value), found.sigma.high if found.hidden else found.sigma.value
    # anything below one number of the file is rounding
    seen = found.uneven > UNEVEN or blocks > max(MOST * noise, step)
    if found.uneven > TIMES * found.uneven_white and seen:
        raise RequestError(
            f"{what}: the patch is not uniform: its parts differ by {100 * found.uneven:.1f} % rms in {name}, in "
            "addition to noise"
        )


def _said(found: PatchNoise) -> Document:
    snr = asdict(found.snr)
    return {
        "mean": asdict(found.mean),
        "sigma": asdict(found.sigma),
        "snr": snr,
        "snr_db": {key: 20 * math.log10(snr[key]) if snr[key] > 0 else math.nan for key in ("value", "low", "high")},
        "slope": found.slope,
        "uneven": found.uneven,
    }
