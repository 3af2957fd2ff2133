"""Camera values from a packaged tuning: full well, conversion gain, black level."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from etendue_camera.cameras.documents import Value
from etendue_camera.cameras.tunings import LICENCE, SOURCE, Tuning, tuning

FOLDER = Path(__file__).parents[1] / "data" / "cameras" / "tunings"


def packaged_tuning(name: str) -> Tuning:
    """Return a packaged tuning."""
    path = FOLDER / f"{name}.json"
    return tuning(path.read_bytes(), path.name)


def values_of_tuning(name: str, given: Mapping[str, Value]) -> tuple[dict[str, Value], dict[str, Value]]:
    """Return camera values of a packaged tuning, at the pitch and bits that are given, and other facts it states."""
    return _values(packaged_tuning(name), f"{SOURCE}, src/ipa/rpi/vc4/data/{name}.json", given)


def values_of(data: bytes, name: str, given: Mapping[str, Value]) -> tuple[dict[str, Value], dict[str, Value]]:
    """Return the same of a tuning's content."""
    return _values(tuning(data, name), name, given)


def _values(own: Tuning, source: str, given: Mapping[str, Value]) -> tuple[dict[str, Value], dict[str, Value]]:
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
            f"not used: its slope {own.slope:g} stands in many files unmeasured",
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
