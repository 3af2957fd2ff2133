"""The names of spectral tables of colour-science and of distributions, so that a plan can reject a wrong name without
importing the library.

In:  a name, and the wavelengths for which it is needed (nm).
Out: nothing, or ValueError with the nearest existing names.

``data/spectral_tables.csv`` lists kind, name and range; a test checks it against colour-science.
"""

import csv
import os
import re
from collections.abc import Collection
from functools import cache
from importlib.resources import files

from etendue import require
from etendue.plugins import discovery
from etendue_camera.spectra.bins import csv_rows, require_name
from etendue_camera.spectra.named import LIBRARY, spectrum

LOWEST_TEMPERATURE = 100.0  # K; colder spectra overflow float64 towards the infrared
COMPUTED = re.compile(r"\s*(\d+\.?\d*(?:[eE][+-]?\d+)?)\s*(K|nm)\s*")
COMPUTED_ILLUMINANTS = "'<T> K' for a Planck radiator, '<w> nm' for a line"
EYE = (360.0, 830.0)  # nm; the visible range as tabulated by the CIE
MOST_OF_IT = (420.0, 680.0)  # nm; contains 99 % of the luminance of every table, and of Planck radiators above 2000 K


@cache
def tables(kind: str) -> dict[str, tuple[float, float]]:
    """Return name to (lowest, highest) wavelength, nm, of every ``illuminant``, ``camera`` or ``display`` table."""
    return {row["name"]: (float(row["lowest_nm"]), float(row["highest_nm"])) for row in _rows_of(kind)}


def _rows_of(kind: str) -> list[dict[str, str]]:
    text = (files("etendue_camera") / "data" / "spectral_tables.csv").read_text(encoding="utf-8")
    rows = csv.DictReader(line for line in text.splitlines() if not line.startswith("#"))
    return [row for row in rows if row["kind"] == kind]


def check_illuminant(name: str, lowest: float, highest: float) -> None:
    """Raise ValueError for an unknown illuminant, or one whose table ends inside the given wavelengths."""
    computed = COMPUTED.fullmatch(name)
    if computed:
        number = float(computed[1])
        require.that(
            computed[2] != "K" or LOWEST_TEMPERATURE <= number,
            f"illuminant temperature must be {LOWEST_TEMPERATURE:g} K or more, got {number:g} K",
        )
        require.that(
            computed[2] != "nm" or lowest <= number <= highest,
            f"spectral line at {number:g} nm lies outside the bins, {lowest:g} to {highest:g} nm",
        )
        return
    if name == "E":
        return
    if name not in tables("illuminant") and not spectrum(name):  # the names of other distributions are read last
        require_name(name, [*tables("illuminant"), *brought()], "illuminant", COMPUTED_ILLUMINANTS)
    first, last = range_of(name)
    require.that(
        not lowest < first and not highest > last,
        f"illuminant {name!r} is tabulated from {first:g} to {last:g} nm, but the bins span "
        f"{lowest:g} to {highest:g} nm; narrow the wavelength axis, or use 'E' or '<T> K'",
    )


def line_of(name: str) -> float | None:
    """Return the wavelength (nm) of a spectral line; None for other lights."""
    computed = COMPUTED.fullmatch(name)
    return float(computed[1]) if computed and computed[2] == "nm" else None


def range_of(name: str, kind: str = "illuminant") -> tuple[float, float]:
    """Return the lowest and highest wavelength (nm) of a table; for a computed light, return the visible range."""
    if kind == "illuminant" and (name == "E" or COMPUTED.fullmatch(name)):
        return EYE
    if not spectrum(name):
        return tables(kind)[name]
    rows = csv_rows(name)[1]
    return float(rows[0]), float(rows[-1])


def brought() -> list[str]:
    """Return the names of tables that distributions provide as files."""
    found = discovery.installed()
    return [name for name in found.names("spectra") if found.all("spectra", name)[-1].value != LIBRARY]


def state_of(name: str) -> tuple[int, int]:
    """Return the modification time (ns) and size (bytes) of a table's file, which identify its content together with
    its name; (0, 0) for a library table.
    """
    found = os.stat(path) if (path := spectrum(name)) else None
    return (found.st_mtime_ns, found.st_size) if found else (0, 0)


def check_camera(name: str) -> None:
    """Raise ValueError for an unknown camera; the path of a CSV table and ``flat`` are accepted."""
    if name not in tables("camera") and not spectrum(name) and name != "flat":
        require_name(name, [*tables("camera"), *brought()], "camera", "the path of a CSV table, or flat")


@cache
def rgb_space_names() -> frozenset[str]:
    """Return the names of the RGB spaces of colour-science."""
    return frozenset(row["name"] for row in _rows_of("rgb_space"))


def check_rgb_space(name: str, besides: Collection[str] = ()) -> None:
    """Raise ValueError for a name that is neither an RGB space nor in ``besides``."""
    require_name(name, [*rgb_space_names(), *besides], "RGB space", ", ".join(map(repr, besides)))
