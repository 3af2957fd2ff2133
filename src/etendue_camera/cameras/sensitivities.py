"""Read camera spectral sensitivities in the form of rawtoaces-data, and write them as tables.

In:  the JSON of one camera, with either of the two kinds of header.
Out: ``Sensitivity``: wavelengths, columns, and who measured it.
Source: AcademySoftwareFoundation/rawtoaces-data. The values are relative and per energy.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from etendue_camera.arrays import FloatArray
from etendue_camera.cameras.names import full_name

SOURCE = "https://github.com/AcademySoftwareFoundation/rawtoaces-data"
MOST_ROWS = 4096


@dataclass(frozen=True)
class Sensitivity:
    """The sensitivity of one camera: wavelengths (n,) in nm ascending, values (n, k), names of its columns."""

    camera: str
    wavelength_nm: FloatArray
    values: FloatArray
    columns: tuple[str, ...]
    creator: str
    licence: str
    per: str = "energy"

    def csv(self) -> str:
        """Return the table as CSV text, relative to the largest value of all columns, to 6 significant digits."""
        head = (
            f"# {self.camera}: relative spectral sensitivity per {self.per}, measured by {self.creator}\n"
            f"# from {SOURCE}, {self.licence}; rounded to 6 digits\n"
            f"wavelength_nm,{','.join(self.columns)}\n"
        )
        rows = zip(self.wavelength_nm, self.values / self.values.max(), strict=True)
        return head + "".join(f"{w:g},{','.join(f'{max(v, 0):.6g}' for v in row)}\n" for w, row in rows)


def sensitivity(data: bytes, name: str) -> Sensitivity:
    """Return the sensitivity in a file's content.

    Raises
    ------
    ValueError
        If a value is missing, has the wrong type, is not finite or does not ascend; the message has one line.
    """
    try:
        document = json.loads(data)
        header, spectral = document["header"], document["spectral_data"]
        columns = tuple(str(one) for one in spectral["index"]["main"])
        rows = spectral["data"]["main"]
        if not isinstance(rows, dict) or not 2 <= len(rows) <= MOST_ROWS or not 1 <= len(columns) <= 16:
            raise ValueError(f"expected 2 to {MOST_ROWS} rows of 1 to 16 columns")
        pairs = sorted((_number(w), [_number(v) for v in row]) for w, row in rows.items())
        table = np.array([row for _, row in pairs])
        wavelengths = np.array([w for w, _ in pairs])
        if table.shape != (len(pairs), len(columns)):
            raise ValueError(f"its rows do not have {len(columns)} numbers each")
        if np.any(np.diff(wavelengths) <= 0) or wavelengths[0] <= 0:
            raise ValueError("its wavelengths do not ascend from above 0 nm")
        if not np.all(table.max(axis=0) > 0):
            raise ValueError("a column has no value above 0")
        camera = full_name(str(header["manufacturer"]), str(header["model"]))
        words = f"{spectral.get('units', '')} {header.get('comments', '')}".casefold()
        per = "photon" if "photon" in words or "quantum" in words else "energy"
        return Sensitivity(
            camera,
            wavelengths,
            table,
            columns,
            str(header.get("document_creator", "unknown")),
            str(header.get("license", "unknown")),
            per,
        )
    except KeyError as error:
        raise ValueError(f"{name} is not a sensitivity of rawtoaces: {error} is missing") from None
    except (ValueError, TypeError, AttributeError, RecursionError) as error:
        text = " ".join(str(error).split())[:160]
        raise ValueError(f"{name} is not a sensitivity of rawtoaces: {text}") from None


def _number(value: Any) -> float:
    if isinstance(value, bool):
        raise ValueError(f"expected a number, got {value}")
    number = float(value)
    if not math.isfinite(number) or abs(number) > 1e9:
        raise ValueError(f"expected a number between -1e9 and 1e9, got {str(value)[:40]}")
    return number
