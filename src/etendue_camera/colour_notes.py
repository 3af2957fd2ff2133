"""Notes on colour information in a picture file that is not applied: all files are read as sRGB.

In:  Pillow's information on a file; PNG chunks; EXIF.
Out: a sentence, or nothing where the file is sRGB or gives no colour information.
Sources: ICC.1; ISO/IEC 15948 (PNG: gAMA, cHRM, cICP); ITU-T H.273 (code points of cICP); DCF 2.0 (Adobe RGB by its
interoperability index).
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from PIL import Image

PRIMARIES = {1: "BT.709", 9: "Rec. 2020", 11: "DCI-P3", 12: "Display P3"}
TRANSFERS = {1: "BT.709", 4: "gamma 2.2", 8: "linear", 13: "sRGB", 16: "PQ", 18: "HLG"}
SRGB_XY = (0.3127, 0.329, 0.64, 0.33, 0.3, 0.6, 0.15, 0.06)
NAMES = ("Display P3", "Adobe RGB", "ProPhoto", "Rec. 2020", "Dot Gain", "Gray Gamma", "sRGB")
# named differently in the library
SPACES = {"Adobe RGB": "Adobe RGB (1998)", "ProPhoto": "ProPhoto RGB", "Rec. 2020": "ITU-R BT.2020"}
EXIF_IFD, INTEROPERABILITY, COLOUR_SPACE, ADOBE = 0x8769, 0xA005, 0xA001, 2


def not_applied(what: str) -> str:
    return f"{what} is not applied: values are read as sRGB"


def is_named(note: str, space: str, encoding: str) -> bool:
    """Return whether the colour information of a file agrees with the colour space in which its values are read and, if
    the information names an encoding curve, also with the curve.
    """
    said = re.search(r"\((.*)\) is not applied", note)
    if said is None:
        return False
    primaries, _, curve = said[1].partition(", ")
    spaces = ("sRGB", "ITU-R BT.709") if primaries == "BT.709" else (SPACES.get(primaries, primaries),)
    return space in spaces and curve in ("", encoding)


def colour_note(info: Any) -> str:
    """Return a note on an embedded profile, gamma or primaries that differ from sRGB; '' otherwise."""
    profile = info.get("icc_profile")
    if profile:
        text = profile.decode("latin-1")
        name = next((n for n in NAMES if n in text or n in text.replace("\0", "")), "of another kind")
        return "" if name == "sRGB" else not_applied(f"its colour profile ({name})")
    if "srgb" in info:
        return ""
    gamma, xy = info.get("gamma"), info.get("chromaticity")
    if gamma and abs(gamma - 1 / 2.2) > 0.01:
        return not_applied(f"its gamma ({gamma:g})")
    if xy and len(xy) == len(SRGB_XY) and np.abs(np.subtract(xy, SRGB_XY)).max() > 0.005:
        return not_applied(f"its primaries (red at {xy[2]:.3g}, {xy[3]:.3g})")
    return ""


def exif_note(exif: Image.Exif, info: Any) -> str:
    """Return a note if a file declares Adobe RGB in its EXIF data, without a profile, as cameras do; '' otherwise."""
    if info.get("icc_profile"):
        return ""
    own = exif.get_ifd(EXIF_IFD)
    index = own.get(INTEROPERABILITY)
    if not isinstance(index, dict):
        try:
            index = exif.get_ifd(INTEROPERABILITY)
        except KeyError:  # raised for files without, before Pillow 12
            index = {}
    adobe = own.get(COLOUR_SPACE) == ADOBE or str(index.get(1, "")).startswith("R03")
    return not_applied("its colour space (Adobe RGB)") if adobe else ""


def png_note(path: str) -> str | None:
    """Return a note on cICP code points, which override a profile; '' for sRGB, None if the file has no code points."""
    with open(path, "rb") as file:
        file.seek(8)
        while len(head := file.read(8)) == 8:
            length, kind = int.from_bytes(head[:4], "big"), head[4:]
            if kind in (b"IDAT", b"IEND"):
                break
            if kind == b"cICP":
                primaries, transfer = file.read(4)[:2]
                if (primaries, transfer) == (1, 13):
                    return ""
                words = PRIMARIES.get(primaries, f"primaries {primaries}"), TRANSFERS.get(transfer, f"curve {transfer}")
                return not_applied(f"its colour space ({', '.join(words)})")
            file.seek(length + 4, 1)
    return None
