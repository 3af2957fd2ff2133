"""Camera values from a packaged tuning: full well, conversion gain, black level, the fall-off of a module's lens."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from etendue_camera.cameras.documents import Value
from etendue_camera.cameras.tunings import GRID, LICENCE, SOURCE, Tuning, tuning
from etendue_camera.field.lens_calibration import FARTHEST, Lens, Point
from etendue_camera.field.lens_files import LensFile

FOLDER = Path(__file__).parents[1] / "data" / "cameras" / "tunings"


def packaged_tuning(name: str) -> Tuning:
    """Return a packaged tuning."""
    path = FOLDER / f"{name}.json"
    return tuning(path.read_bytes(), path.name)


def values_of(own: Tuning, source: str, given: Mapping[str, Value]) -> tuple[dict[str, Value], dict[str, Value]]:
    """Return camera values of a tuning for a given pitch and number of bits, and other facts that the tuning states."""
    bits = int(given["bits"].value)
    pitch = float(str(given["pixel_pitch"].value).split()[0])
    found = {"black_level": Value(round(own.black / 2 ** (16 - bits), 3), source, f"in {bits} bits", LICENCE)}
    facts = {}
    if own.matrices:
        facts["colour_matrices"] = Value(
            f"{len(own.matrices)}, {own.matrices[0][0]:g} to {own.matrices[-1][0]:g} K", source, "not used", LICENCE
        )
    if own.largest_gain:
        facts["largest_gain"] = Value(own.largest_gain, source, "of its exposure modes", LICENCE)
    charge, gain = own.full_scale(), own.gain(bits)
    if charge is None or gain is None:
        return found, facts
    if own.looks_like_a_default():
        facts["full_scale"] = Value(
            f"{charge:.0f} electron",
            source,
            f"not used: its slope {own.slope:g} is an unmeasured value in many files",
            LICENCE,
        )
        return found, facts
    note = f"full scale {charge:.0f} electrons: (65535 - black) / {own.slope:g}^2"
    facts["full_scale"] = Value(f"{charge:.0f} electron", source, "at analogue gain 1", LICENCE)
    found["full_well_density"] = Value(
        f"{charge / pitch**2:.6g} electron um-2", source, f"{note}, over {pitch:g} um x {pitch:g} um", LICENCE
    )
    found["conversion_gain"] = Value(f"{gain:.6g} DN/electron", source, "slope^2 at analogue gain 1", LICENCE)
    return found, facts


def lens_of_tuning(name: str, body: str, crop_factor: float, words: str) -> tuple[LensFile, float]:
    """Return the lens that the shading table of a packaged tuning describes, and the rms difference between the table
    and its polynomial.

    The inverse of the gains is fitted by 1 + k1 r^2 + k2 r^4 + k3 r^6 by least squares, with r = 1 at the corner.
    """
    own = packaged_tuning(name)
    found = own.fall_off()
    if found is None:
        raise ValueError(f"the tuning {name} has no shading table")
    r, relative = found
    square = r * r
    powers = np.stack([np.ones_like(r), square, square**2, square**3], axis=1)
    terms, *_ = np.linalg.lstsq(powers, relative, rcond=None)
    rms = float(np.sqrt(np.mean((powers @ terms - relative) ** 2)) / terms[0])
    focal, aperture = (float(word) for word in words.replace("f/", "").split())
    k1, k2, k3 = (float(f"{one:.6g}") for one in terms[1:] / terms[0])
    point = Point("pa", (k1, k2, k3), focal, aperture, FARTHEST)
    columns_over_rows = GRID[1] / GRID[0]
    entry = Lens(
        "",
        f"{body} lens",
        (body,),
        (body,),
        crop_factor,
        columns_over_rows,
        (focal, focal),
        (aperture, 0.0),
        (),
        (),
        (point,),
    )
    return LensFile(f"{body} lens", f"{SOURCE}, src/ipa/rpi/vc4/data/{name}.json", LICENCE, (entry,)), rms
