"""Files of other programs with data of a camera, converted to a body in the form of a sensor file.

In:  a path.
Out: ``Named``, or the text of a sensitivity table; a file without camera values raises an error.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from etendue import plain_files
from etendue.errors import RequestError
from etendue_camera.arrays import FloatArray
from etendue_camera.cameras import bodies, camconst, dng
from etendue_camera.cameras.documents import Named, Value
from etendue_camera.cameras.sensitivities import sensitivity
from etendue_camera.cameras.tuned import values_of
from etendue_camera.cameras.tunings import tuning

LARGEST_JSON, LARGEST_RAW = 8 << 20, 512 << 20
KNOWN = "a DNG, a tuning of libcamera, a sensitivity of rawtoaces, a camconst.json of RawTherapee"
DARKTABLE = (
    "is a file of noise profiles of darktable: they are taken from demosaiced, white-balanced pictures, so they do not "
    "give electrons (1/a is 4 to 21 times too large, and many b are negative); measure with etendue calibrate instead"
)


def is_path(text: str) -> bool:
    """Return whether a text names a file rather than a camera."""
    return Path(text).suffix.casefold() in (".dng", ".json", ".xml") and Path(text).is_file()


def named_in(path: Path) -> Named:
    """Return the camera of a file, with stand-ins for missing values.

    Raises
    ------
    RequestError
        If the file has no known format, or contains several cameras; the message has one line.
    """
    try:
        if path.suffix.casefold() == ".dng":
            return _of_raw(dng.raw(plain_files.content(path, LARGEST_RAW), path.name))
        data = plain_files.content(path, LARGEST_JSON)
    except (OSError, ValueError) as error:
        raise RequestError(getattr(error, "strerror", None) or str(error)) from None
    if b"noiseprofiles" in data[:4096]:
        raise RequestError(f"{path.name} {DARKTABLE}")
    try:
        if b'"camera_constants"' in data:
            count = len(camconst.constants(data, path.name))
            raise RequestError(
                f"{path.name} holds {count} cameras: add its path to ETENDUE_CAMERAS, so that bodies take their levels "
                "from it"
            )
        document = json.loads(data)
    except (ValueError, RecursionError) as error:
        raise RequestError(f"{path.name} is none of these: {KNOWN} ({' '.join(str(error).split())[:80]})") from None
    if isinstance(document, dict) and "algorithms" in document:
        return _of_tuning(data, path)
    if isinstance(document, dict) and "spectral_data" in document:
        return _of_sensitivity(data, path)
    raise RequestError(f"{path.name} is none of these: {KNOWN}")


def table_in(path: Path) -> str | None:
    """Return the sensitivity table of a file as CSV; None if the file has none."""
    data = plain_files.content(path, LARGEST_RAW)
    return sensitivity(data, path.name).csv() if b'"spectral_data"' in data[:LARGEST_JSON] else None


def _of_tuning(data: bytes, path: Path) -> Named:
    try:
        given = bodies.stand_ins("phone")
        found, facts = values_of(tuning(data, path.name), path.name, given)
    except ValueError as error:
        raise RequestError(str(error)) from None
    return Named(path.stem, "body", "a sensor tuning of libcamera; other values are stand-ins", given | found, facts)


def _of_sensitivity(data: bytes, path: Path) -> Named:
    try:
        own = sensitivity(data, path.name)
    except ValueError as error:
        raise RequestError(str(error)) from None
    given = bodies.stand_ins("full frame")
    words = {"sensitivity": f"./{path.stem}.csv", "sensitivity_kind": "system_qe", "sensitivity_per": own.per}
    given |= {key: Value(value, path.name, f"measured by {own.creator}", own.licence) for key, value in words.items()}
    facts = {"table": Value(f"{len(own.wavelength_nm)} rows", path.name, "write it with -o NAME.csv", own.licence)}
    return Named(own.camera, "body", "a measured sensitivity; other values are stand-ins", given, facts)


def _of_raw(own: dng.Raw) -> Named:
    """Return the values of a DNG. Its noise profile determines charges (electron) at the ISO of the file."""
    given = bodies.stand_ins("full frame")
    source = f"DNG of {own.model}"
    facts = {"pixels": Value(f"{own.width} x {own.height}", source)}
    if own.white is not None:
        bits = int(own.white + 1).bit_length() - (0 if (int(own.white) + 1) & int(own.white) else 1)
        given["bits"] = Value(min(16, max(1, bits)), source, f"white level {own.white:g}")
    if own.black is not None:
        given["black_level"] = Value(round(own.black, 3), source)
    if own.pattern:
        given["pattern"] = Value(own.pattern, source, "CFAPattern")
    at = "" if own.iso is None else f" at ISO {own.iso:g}"
    charge, noise = own.full_scale(), own.read_noise()
    if charge is not None and noise is not None:
        pitch = float(str(given["pixel_pitch"].value).split()[0])
        note = f"1/S of its NoiseProfile is {charge:.0f} electrons{at}, over {pitch:g} um x {pitch:g} um"
        given["full_well_density"] = Value(f"{charge / pitch**2:.6g} electron um-2", source, note)
        given["read_noise"] = Value(round(noise, 4), source, f"sqrt(O)/S of its NoiseProfile{at}")
        if own.white is not None and own.black is not None:
            gain = (own.white - own.black) / charge
            given["conversion_gain"] = Value(f"{gain:.6g} DN/electron", source, f"white less black over 1/S{at}")
    for number, (light, matrix) in enumerate(own.matrices, 1):
        row = ", ".join(f"{one:.4f}" for one in matrix.ravel())
        facts[f"colour_matrix_{number}"] = Value(row, source, f"from XYZ, EXIF light source {light}; not used")
    for name, table in lens_tables(own, float(str(given["pixel_pitch"].value).split()[0])).items():
        facts[name] = Value(f"{table.count(chr(10)) - 1} rows", source, f"write it with -o NAME.{name}.csv")
    if own.other:
        facts["other_opcodes"] = Value(", ".join(map(str, own.other)), source, "not read")
    return Named(own.model, "body", "camera data of a raw file; other values are stand-ins", given, facts)


def lens_tables(own: dng.Raw, pitch_um: float) -> dict[str, str]:
    """Return the tables of the stages ``distortion`` and ``falloff`` from the opcodes of a DNG, as CSV."""
    corner = 0.5e-3 * pitch_um * float(np.hypot(own.width, own.height))
    r = np.linspace(0.0, 1.0, 129)
    found = {}
    moved, light = own.real(r), own.fall_off(r)
    if moved is not None:
        colours = (600, 540, 460) if moved.shape[1] == 3 else (550,)
        columns = moved[:, : len(colours)][:, ::-1]
        found["distortion"] = _csv("ideal_mm", [str(one) for one in sorted(colours)], r * corner, columns * corner)
    if light is not None:
        found["falloff"] = _csv("height_mm", ["ratio"], r * corner, light[:, None])
    return found


def _csv(axis: str, names: list[str], heights: FloatArray, columns: FloatArray) -> str:
    rows = (f"{h:.9g},{','.join(f'{v:.9g}' for v in row)}\n" for h, row in zip(heights, columns, strict=True))
    return f"{axis},{','.join(names)}\n" + "".join(rows)
