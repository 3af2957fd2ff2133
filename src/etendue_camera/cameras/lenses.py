"""Lenses by name, from the user's copy of the lens database.

In:  the name of a lens as typed.
Out: ``Named``: its focal length and its calibrations as a lens file.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from etendue.errors import RequestError
from etendue_camera.cameras import bodies
from etendue_camera.cameras.databases import INSTALL, Index, lens_index
from etendue_camera.cameras.documents import Named, Value, kept
from etendue_camera.cameras.lensfun import LICENCE
from etendue_camera.cameras.names import meant
from etendue_camera.cameras.tuned import lens_of_tuning
from etendue_camera.field.lens_files import ENDING, LensFile

LISTED = "etendue cameras --lenses"
WORDS = {
    "distortion": ("distortion", "none is applied"),
    "tca": ("lateral_colour", "none is applied"),
    "vignetting": ("fall_off", "the cos4 law is used instead"),
}


def index() -> Index:
    """Return the index of the lens database.

    Raises
    ------
    RequestError
        If there is no database (the message has the commands that install one), or it cannot be read.
    """
    try:
        found = lens_index()
    except ValueError as error:
        raise RequestError(f"the lens database: {error}") from None
    if found is None:
        raise RequestError(f"more lenses require a copy of the lensfun database, but none was found: {INSTALL}")
    return found


def full_lens_name(text: str) -> str:
    """Return the full name of the lens that the user typed; an error gives the reason if that lens cannot be used."""
    packaged = module_lenses()
    try:
        return meant(text, packaged, "lens", LISTED)
    except RequestError as error:
        try:
            own = index()
        except RequestError as none:
            raise RequestError(f"{error}; {none}") from None
    refused = {name: why for name, why in own.refused if name not in own.lenses}
    name = meant(text, [*packaged, *own.lenses, *refused], "lens", LISTED)
    if name in refused:
        raise RequestError(f"the lens {name!r} cannot be used: {refused[name]}")
    return name


def lens(name: str) -> tuple[Named, LensFile]:
    """Return the lens with this full name, and its file."""
    if name in module_lenses():
        return _module_lens(name)
    own = index()
    held = LensFile(name, own.source(), LICENCE, tuple(own.entries(name)))
    path = kept(held.text(), ENDING)
    first = held.entries[0]
    low, high = min(one.focal[0] for one in held.entries), max(one.focal[1] for one in held.entries)
    source = own.source()

    def measured(value: Any, note: str = "") -> Value:
        return Value(value, source, note, LICENCE)

    if low == high:
        focal = measured(f"{low:g} mm", "as its name or entry says")
    else:
        focal = Value(f"{low:g} mm", "typical", f"the short end of {low:g} to {high:g} mm; give focal_length")
    span = f"{low:g}" if low == high else f"{low:g} to {high:g}"
    wide = f", f/{first.aperture[0]:g}" if first.aperture[0] else ""
    facts = {
        "mounts": measured(", ".join(sorted({mount for one in held.entries for mount in one.mounts}))),
        "calibrated_on": measured(
            ", ".join(f"crop factor {one.crop_factor:g}" for one in held.entries),
            "the entry that fits the body is used",
        ),
    }
    for kind, (words, instead) in WORDS.items():
        count = sum(len(getattr(one, kind)) for one in held.entries)
        facts[words] = measured(f"{count} calibrations") if count else Value("none", "typical", instead)
    camera = {"focal_length": focal, "lens_profile": measured(path.name, "calibrations of its entries")}
    return Named(name, "lens", f"{span} mm{wide}, {', '.join(first.mounts[:3])}", camera, facts), held


def module_lenses() -> dict[str, str]:
    """Return the lenses of packaged tunings by name, each with its body."""
    return {f"{body} lens": body for body, row in bodies.packaged().items() if row["lens"]}


def _module_lens(name: str) -> tuple[Named, LensFile]:
    body = module_lenses()[name]
    row = bodies.packaged()[body]
    crop = float(bodies.formats()[row["format"]]["crop"])
    held, rms = lens_of_tuning(row["tuning"], body, crop, row["lens"])
    path = kept(held.text(), ENDING)
    focal, aperture = row["lens"].split()
    note = f"its shading table (luminance_lut) by a polynomial in r^2, within {100 * rms:.2g} % rms"
    camera = {
        "focal_length": Value(
            f"{focal} mm", "typical", "of the lens that is usual on this module; the tuning names none"
        ),
        "lens_profile": Value(path.name, held.source, note, held.licence),
    }
    facts = {"fall_off": Value("192 cells", held.source, note, held.licence)}
    return Named(name, "lens", f"{focal} mm, {aperture}, of the module", camera, facts), held


def found(text: str) -> Path:
    """Return the file of the lens that ``[camera] lens`` names."""
    return kept(lens(full_lens_name(text))[0].toml(), ".toml")
