"""Tables of lens effects: point spread functions, distortion, relative illumination.

In:  a ``Lens``, field angles or the size of a frame, wavelengths.
Out: a ``PsfBank``; curves over the image height.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from etendue_camera.field.psf_bank import PsfBank
from etendue_lens_optiland import pupil
from etendue_lens_optiland.lens import Lens

FloatArray = NDArray[np.floating]

LARGEST_PICTURE, LARGEST_PUPIL = 1023, 1024
BRIGHTEST = 1.5
"""Limit of relative illumination: a pupil that grows by more towards the corner is rejected."""
_FINER = 0.85  # sample spacing of a PSF relative to the largest spacing that its cut-off frequency allows


@dataclass(frozen=True, eq=False)
class Traced:
    """A PSF bank and how it was computed.

    Attributes
    ----------
    bank : PsfBank
    enclosed : (K, L) array, 1
        Fraction of a PSF's flux within its window. The bank scales the sum of each PSF to 1.
    samples : int
        Samples across the pupil, as many as requested or as the window needs.
    """

    bank: PsfBank
    enclosed: FloatArray
    samples: int


def tangents_of(degrees: Any) -> FloatArray:
    """Return the tangents of field angles.

    Raises
    ------
    ValueError
        Unless the angles ascend from 0 or above to below 89 degrees.
    """
    angles = np.asarray(degrees, dtype=float)
    if angles.ndim != 1 or angles.size < 1 or not np.all(np.diff(angles) > 0) or angles[0] < 0 or angles[-1] >= 89:
        raise ValueError(f"fields are {list(degrees)}; they must ascend, from 0 or above to below 89 degrees")
    return np.tan(np.radians(angles))


def resolved(lens: Lens, tangent: float, wavelength: float, samples: int) -> pupil.Bundle:
    """Return a bundle in which the phases of neighbouring rays differ by at most about 1 rad, except for the outermost
    1 % of the rays. The bundle has ``samples`` cells across or, if necessary, more, up to 512.
    """
    bundle = lens.bundle(tangent, wavelength, samples)
    needed = math.ceil(samples * 2.0 * math.pi * _radius(bundle, 0.01) / min(pupil.reach(bundle)))
    return bundle if needed <= samples else lens.bundle(tangent, wavelength, min(needed, max(samples, 512)))


def psf_bank(
    lens: Lens,
    tangents: FloatArray,
    wavelengths: tuple[float, ...],
    samples: int = 128,
    window: float = 0.0,
    lost: float = 0.02,
) -> Traced:
    """Compute PSFs of a distant point at fields and wavelengths.

    Parameters
    ----------
    lens : Lens
    tangents : (K,) array, 1
        Tangents of the field angles, ascending.
    wavelengths : tuple of float, um
        Ascending.
    samples : int
        Smallest number of samples across the pupil.
    window : float, um
        Side of the PSF windows; 0: set by ``lost``.
    lost : float
        Fraction of the flux allowed outside the window if ``window`` is 0. Half of it is allowed for aberrated rays,
        half for diffraction (2/(pi v) of an Airy pattern lies outside v = pi r/(lambda N)).

    Raises
    ------
    ValueError
        For fields that no light passes, and PSFs or pupils that would need more than 1023 samples across.

    Notes
    -----
    The sample spacing is 0.85 of the largest spacing that the cut-off frequency of the widest pupil allows. Each PSF is
    centred on the chief ray of its wavelength: lateral colour is part of the distortion. Image heights are those at the
    reference wavelength.
    """
    found = [[lens.bundle(float(t), w, samples) for w in wavelengths] for t in tangents]
    spacing = np.array([_FINER * w / (2.0 * max(row[i].range for row in found)) for i, w in enumerate(wavelengths)])
    if window <= 0:
        window = 2.0 * max(_needed(bundle, lost) for row in found for bundle in row)
    half = math.ceil(0.5 * window / float(spacing.min()))
    size = 2 * half + 1
    if size > LARGEST_PICTURE:
        raise ValueError(
            f"PSF windows of {window:.4g} um at a spacing of {spacing.min():.3g} um need {size} samples across, more "
            f"than {LARGEST_PICTURE}; use a larger f_number, a larger lost, or give a window"
        )
    # the sampled pupil repeats its PSF: the repetition must stay outside the window
    wanted = samples
    for row in found:
        for bundle, step in zip(row, spacing, strict=True):
            free = half * float(step) + max(half * float(step), _needed(bundle, lost))
            wanted = max(wanted, math.ceil(samples * 1.05 * free / min(pupil.reach(bundle))))
    if wanted > LARGEST_PUPIL:
        raise ValueError(
            f"PSF windows of {window:.4g} um need {wanted} cells across the pupil, more than {LARGEST_PUPIL}; use a "
            f"larger f_number or lost, "
            "or give a smaller window"
        )
    if wanted > samples:
        found = [[lens.bundle(float(t), w, wanted) for w in wavelengths] for t in tangents]
    pictures = np.array(
        [[pupil.picture(b, size, float(s)) for b, s in zip(row, spacing, strict=True)] for row in found]
    )
    total = np.array([[pupil.flux(b) / float(s) ** 2 for b, s in zip(row, spacing, strict=True)] for row in found])
    heights = lens.chief(tangents, lens.reference)[1]
    source = f"{lens.prescription.name}, {lens.focal_length_um * 1e-3:g} mm, f/{lens.f_number:g}"
    return Traced(
        PsfBank(heights, np.array(wavelengths), pictures, spacing, source), pictures.sum(axis=(2, 3)) / total, wanted
    )


def _radius(bundle: pupil.Bundle, lost: float) -> float:
    """Return the distance (um) from the image point beyond which a fraction ``lost`` of the rays lands."""
    distance = np.hypot(bundle.across_y, bundle.across_x)
    order = np.argsort(distance)
    return float(distance[order][pupil.place_of(bundle.open[order], 1.0 - lost)])


def _needed(bundle: pupil.Bundle, lost: float) -> float:
    """Return the radius (um) beyond which a fraction of about ``lost`` of a PSF's flux lies."""
    return _radius(bundle, 0.5 * lost) + 2.0 * bundle.wavelength / bundle.range / (math.pi**2 * 0.5 * lost)


def nodes_to(lens: Lens, corner_um: float, wavelengths: tuple[float, ...], count: int) -> FloatArray:
    """Return evenly spaced tangents of field angles, from the axis to a field that reaches the image height
    ``corner_um`` at every wavelength.
    """
    farthest = lens.tangent_for(max(corner_um, 1e-3 * lens.focal_length_um), wavelengths)
    return np.linspace(0.0, farthest, count)


def ideal_over_real(
    lens: Lens, corner_um: float, wavelengths: tuple[float, ...], count: int
) -> list[scipy.interpolate.CubicSpline]:
    """Return the ratio of ideal to real image height as a function of the squared real height (um2), one curve per
    wavelength.

    The ideal height is that of a pinhole: the image distance at the reference wavelength times the tangent of the field
    angle. On axis the curve is 1 at the reference wavelength; at another wavelength it is the ratio of the image
    scales.
    """
    tangents = nodes_to(lens, corner_um, wavelengths, count)[1:]
    ideal = lens.image_distance_um * tangents
    curves = []
    for real in lens.heights(tangents, wavelengths):
        ratio = ideal / real
        # the ratio is even and smooth in the height: its value on the axis follows from the nearest nodes
        squares = real[:3] ** 2
        axis = float(np.polynomial.Polynomial.fit(squares, ratio[:3], 2)(0.0)) if count > 3 else float(ratio[0])
        curves.append(scipy.interpolate.CubicSpline(np.append(0.0, real**2), np.append(axis, ratio)))
    return curves


def relative_illumination(
    lens: Lens, corner_um: float, wavelengths: tuple[float, ...], count: int, samples: int
) -> list[scipy.interpolate.CubicSpline]:
    """Return irradiance relative to the axis over the squared image height (um2), one curve per wavelength."""
    tangents = nodes_to(lens, corner_um, wavelengths, count)
    found = lens.illumination(tangents, wavelengths, samples)
    heights = lens.heights(tangents, wavelengths)
    relative = found / found[:, :1]
    if relative.max() > BRIGHTEST:
        raise ValueError(
            f"{lens.prescription.name} gives its corner {relative.max():.3g} times the light of its axis; at most "
            f"{BRIGHTEST:g} is allowed"
        )
    return [scipy.interpolate.CubicSpline(h**2, e) for h, e in zip(heights, relative, strict=True)]
