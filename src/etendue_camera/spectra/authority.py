"""Access to colour-science, the source of every shipped table. This is the only module that imports it, at the first
call that needs it.

In:  nothing, or the kind and name of a table.
Out: its tables as plain float64 arrays; ValueError with the nearest names for an unknown name.
Sources: the data and matrices of colour-science; CIE 15:2018 for interpolation.

A smooth table with rows coarser than 1 nm is interpolated to 1 nm by Sprague's quintic. Negative values that result at
steep feet (at most 1.4e-4 of a channel's area) are set to 0.
"""

import importlib.metadata
import sys
import threading
from collections.abc import Callable, Mapping
from functools import lru_cache
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from etendue.process import unwarned
from etendue_camera.spectra.bins import FloatArray, require_name

UNWANTED_WARNING = "related API features are not available"
OBSERVERS = ("CIE 1931 2 Degree Standard Observer", "Stockman & Sharpe 2 Degree Cone Fundamentals")
COLORCHECKER = "BabelColor Average"
BASIS = "Mallett 2019"
_path = threading.Lock()


def colour_version() -> str:
    """Return the version of the installed colour-science, read without importing it."""
    return importlib.metadata.version("colour-science")


@lru_cache(maxsize=1)
def colour_science() -> ModuleType:
    """Import colour-science when it is first needed, without its warnings about optional packages that etendue does not
    use.

    A file ``colour.py`` next to a user's script would shadow it, so folders that contain one are not searched.
    """
    with _path:
        kept = sys.path[:]
        sys.path[:] = [folder for folder in kept if not Path(folder, "colour.py").is_file()]
        try:
            with unwarned(UNWANTED_WARNING):
                import colour
        finally:
            sys.path[:] = kept
    return colour


# ------------------------------------------------------------------------------------------ rows of a table


def rows_of(table: Any) -> FloatArray:
    """Return (rows, 1 + k): wavelengths (nm), then the values of each column."""
    nodes, values = np.array(table.wavelengths, dtype=np.float64), np.array(table.values, dtype=np.float64)
    return np.column_stack([nodes, values])


def smooth_rows(table: Any) -> FloatArray:
    """Return `rows_of` at 1 nm: Sprague-interpolated where the table is uniform and coarser, otherwise unchanged."""
    rows = rows_of(table)
    nodes, columns = rows[:, 0], rows[:, 1:].T
    steps = np.diff(nodes)
    if not np.allclose(steps, steps[0], rtol=1e-9) or steps[0] <= 1.0 or len(nodes) < 6:
        return rows
    fine = np.linspace(nodes[0], nodes[-1], round(nodes[-1] - nodes[0]) + 1)
    curves = np.stack(
        [colour_science().SpragueInterpolator(nodes, np.array(column))(fine) for column in columns], axis=1
    )
    if columns.min() >= 0:
        curves = np.maximum(curves, 0.0)
    return np.column_stack([fine, curves])


TABLES: dict[str, tuple[Callable[[], Mapping[str, Any]], Callable[[Any], FloatArray]]] = {
    "illuminant": (lambda: colour_science().SDS_ILLUMINANTS, rows_of),
    "camera": (lambda: colour_science().MSDS_CAMERA_SENSITIVITIES, rows_of),
    "smooth camera": (lambda: colour_science().MSDS_CAMERA_SENSITIVITIES, smooth_rows),
    "display": (lambda: colour_science().MSDS_DISPLAY_PRIMARIES, rows_of),
    "observer": (lambda: colour_science().MSDS_CMFS, smooth_rows),
    "patch": (lambda: colour_science().SDS_COLOURCHECKERS[COLORCHECKER], smooth_rows),
    "basis": (lambda: {BASIS: colour_science().recovery.MSDS_BASIS_FUNCTIONS_sRGB_MALLETT2019}, smooth_rows),
}


def rows(kind: str, name: str, besides: str = "") -> FloatArray:
    """Return the rows of one table; raise ValueError with the nearest names if there is none."""
    tables, form = TABLES[kind]
    return form(lookup(tables(), name, kind.rpartition(" ")[2], besides))


def lookup(table: Mapping[str, Any], name: str, kind: str, besides: str = "") -> Any:
    """Return ``table[name]`` for an exact name; raise ValueError with the nearest names if there is none."""
    require_name(name, table.keys(), kind, besides)
    return table[name]


# --------------------------------------------------------------------------------------- spaces and matrices


def space_of(name: str) -> dict[str, Any]:
    """Return an RGB space: its matrix to XYZ, the chromaticities of its primaries (3, 2) and white (2,), the name of
    its white.
    """
    space = lookup(colour_science().RGB_COLOURSPACES, name, "RGB space")
    return {
        "matrix": np.array(space.matrix_RGB_to_XYZ, dtype=np.float64),
        "primaries": np.array(space.primaries, dtype=np.float64).reshape(3, 2),
        "white": np.array(space.whitepoint, dtype=np.float64),
        "white_name": str(space.whitepoint_name),
    }


def whites() -> dict[str, FloatArray]:
    """Return published chromaticities (2,) of illuminants, for the CIE 1931 2 degree observer."""
    known = colour_science().CCS_ILLUMINANTS[OBSERVERS[0]]
    return {name: np.array(known[name], dtype=np.float64) for name in list(known)}


def adaptation_of(name: str) -> FloatArray:
    """Return the matrix from XYZ to sharpened cone responses, (3, 3)."""
    return np.array(
        lookup(colour_science().adaptation.CHROMATIC_ADAPTATION_TRANSFORMS, name, "adaptation transform"),
        dtype=np.float64,
    )


# ----------------------------------------------------------------------------------------------- all of them


def everything() -> dict[str, np.ndarray[Any, Any]]:
    """Return all tables that a stage may need, as arrays by name. Tables of one kind are stacked; the numbers of RGB
    spaces and matrices are concatenated.
    """
    found: dict[str, np.ndarray[Any, Any]] = {}
    for kind, (tables, form) in TABLES.items():
        names = list(OBSERVERS) if kind == "observer" else list(tables())
        stacked = [form(tables()[name]) for name in names]
        found |= {
            f"{kind}/names": np.array(names),
            f"{kind}/sizes": np.array([len(own) for own in stacked]),
            f"{kind}/rows": np.vstack(stacked),
        }
    names = list(colour_science().RGB_COLOURSPACES)
    spaces = [space_of(name) for name in names]
    found["space/names"] = np.array(names)
    found |= {f"space/{word}": np.stack([space[word] for space in spaces]) for word in ("matrix", "primaries", "white")}
    found["space/white_name"] = np.array([space["white_name"] for space in spaces])
    found |= {"white/names": np.array(list(whites())), "white/xy": np.stack(list(whites().values()))}
    transforms = list(colour_science().adaptation.CHROMATIC_ADAPTATION_TRANSFORMS)
    found |= {
        "adaptation/names": np.array(transforms),
        "adaptation/matrix": np.stack([adaptation_of(name) for name in transforms]),
    }
    return found
