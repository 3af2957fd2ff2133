"""Camera bodies by name: measured sensitivities, tunings, published values, crop factor and mount; stand-ins for other
values.

In:  the name of a body as typed.
Out: ``Named``: all quantities of a sensor, each with its source; the list of quantities is the same for every body.
"""

from __future__ import annotations

import csv
import math
import tomllib
from collections.abc import Mapping
from decimal import Decimal
from functools import cache
from pathlib import Path

from etendue import plain_files
from etendue.errors import RequestError
from etendue.types.documents import Document, DocumentView
from etendue_camera.cameras import camconst
from etendue_camera.cameras.databases import Index, given_files, installed_files, lens_index
from etendue_camera.cameras.documents import Named, Value, kept
from etendue_camera.cameras.lensfun import LICENCE, Camera
from etendue_camera.cameras.names import meant, plain
from etendue_camera.cameras.tuned import packaged_tuning, values_of
from etendue_camera.cameras.tunings import SOURCE

DATA = Path(__file__).parents[1] / "data"
LISTED = "etendue cameras"
FROM_LIBRARY = "https://github.com/AcademySoftwareFoundation/rawtoaces-data"
TYPICAL = "typical"


@cache
def packaged() -> dict[str, dict[str, str]]:
    """Return the rows of ``bodies.csv`` by the name of the body."""
    return {row["body"]: row for row in _rows("bodies.csv")}


@cache
def sensitivities() -> dict[str, dict[str, str]]:
    """Return the rows of ``sensitivities.csv`` by the name of the camera."""
    return {row["camera"]: row for row in _rows("sensitivities.csv")}


def _rows(name: str) -> list[dict[str, str]]:
    text = (DATA / "cameras" / name).read_text(encoding="utf-8")
    return list(csv.DictReader(line for line in text.splitlines() if not line.startswith("#")))


@cache
def formats() -> dict[str, Document]:
    """Return the stand-ins for values that no source gives, by the format of the sensor."""
    text = (DATA / "cameras" / "formats.toml").read_text(encoding="utf-8")
    return tomllib.loads(text, parse_float=Decimal)


def cameras() -> dict[str, Camera]:
    """Return the cameras of the lens database by name; empty without it."""
    index = _index()
    return {one.name(): one for one in index.cameras} if index else {}


def _index() -> Index | None:
    try:
        return lens_index()
    except ValueError as error:
        raise RequestError(f"the lens database: {error}") from None


def found_body(text: str) -> Named:
    """Return the body whose name the user typed.

    Raises
    ------
    RequestError
        If the text matches no body, or several.
    """
    try:
        name = meant(text, packaged(), "body", LISTED)
    except RequestError:
        others = {other: name for name, one in cameras().items() for other in (name, *one.also)}
        name = meant(text, [*packaged(), *others], "body", LISTED)
        name = others.get(name, name)
    return body(name)


def body(name: str) -> Named:
    """Return a body by its full name."""
    row = packaged().get(name, {})
    listed = next((one for own, one in cameras().items() if plain(own) == plain(name)), None)
    crop = math.log(listed.crop_factor if listed else 1.0)
    crops = {name: float(one["crop"]) for name, one in formats().items() if name not in ("all", "machine vision")}
    form = row.get("format") or min(crops, key=lambda name: abs(math.log(crops[name]) - crop))  # nearest in ratio
    given = stand_ins(form)
    facts = {"format": Value(form, TYPICAL, "as makers name it; the stand-ins depend on it")}
    if row.get("tuning"):
        tuning = row["tuning"]
        tuned, more = values_of(packaged_tuning(tuning), f"{SOURCE}, src/ipa/rpi/vc4/data/{tuning}.json", given)
        given |= tuned
        facts |= more
    if row.get("sensor"):
        given |= _published(row["sensor"])
    if row.get("pattern"):
        given["pattern"] = Value(row["pattern"], TYPICAL, "the colour filters that the maker names")
    if row.get("sensitivity"):
        given |= _measured(row["sensitivity"])
    if listed:
        source = "lensfun database (https://lensfun.github.io)"
        given["crop_factor"] = Value(listed.crop_factor, source, licence=LICENCE)
        given["mount"] = Value(listed.mount, source, licence=LICENCE)
    given |= _levels(name, given)
    lacking = [key for key, one in given.items() if one.source.startswith(TYPICAL)]
    return Named(
        name,
        "body",
        f"{form}; {len(given) - len(lacking)} of {len(given)} values have a source, {len(lacking)} are stand-ins",
        given,
        facts,
    )


def stand_ins(form: str) -> dict[str, Value]:
    """Return the stand-in values of a sensor format by quantity, in the order of the body's document."""
    own = formats()[form]
    note = f"of {form} sensors"
    words = {**{key: value for key, value in own.items() if key != "crop"}, **formats()["all"]}
    given = {key: Value(value, TYPICAL, note) for key, value in words.items()}
    given["sensitivity"] = Value(words["sensitivity"], TYPICAL, "a stand-in: the measured curves of another camera")
    given["crop_factor"] = Value(
        own["crop"], TYPICAL, f"of {form} sensors; the lens database has the crop factors of bodies"
    )
    given["mount"] = Value("", TYPICAL, "unknown without the lens database: no lens is refused")
    return given


def _measured(camera: str) -> dict[str, Value]:
    row = sensitivities()[camera]
    note = f"measured by {row['creator']}"
    return {
        "sensitivity": Value(camera, FROM_LIBRARY, note, row["licence"]),
        "sensitivity_kind": Value("system_qe", FROM_LIBRARY, "measured with the whole camera", row["licence"]),
        "sensitivity_per": Value(
            row["per"],
            FROM_LIBRARY,
            "in this form the curves agree with makers' DNG matrices; per photon they do not",
            row["licence"],
        ),
    }


def _levels(name: str, given: Mapping[str, Value]) -> dict[str, Value]:
    """Return the black level from the user's copy of camconst.json, unless another source gives it."""
    own = next((one for known, one in levels().items() if plain(known) == plain(name)), None)
    if own is None or own.black is None or not given["black_level"].source.startswith(TYPICAL):
        return {}
    white = own.white or 0.0
    bits = int(white).bit_length()
    found = {"black_level": Value(own.black, camconst.SOURCE, "", camconst.LICENCE)}
    if 10 <= bits <= 16 and given["bits"].source.startswith(TYPICAL):
        found["bits"] = Value(bits, camconst.SOURCE, f"white level {white:g}", camconst.LICENCE)
    return found


@cache
def levels() -> dict[str, camconst.Constants]:
    """Return the camera constants in the user's copy of RawTherapee's file, by camera; empty without a copy."""
    places = [*given_files(".json", "camconst.json"), *installed_files("/usr/share/rawtherapee/camconst.json")]
    path = next((one for one in places if one.is_file()), None)
    if path is None:
        return {}
    try:
        return camconst.constants(plain_files.content(path, 8 << 20), path.name)
    except (OSError, ValueError) as error:
        raise RequestError(str(error)) from None


def _published(sensor: str) -> dict[str, Value]:
    """Return the values of a packaged sensor, except its curves."""
    text = (DATA / "sensors" / f"{sensor}.toml").read_text(encoding="utf-8")
    document: DocumentView = tomllib.loads(text, parse_float=Decimal)
    return {
        key: Value(one["value"], one["source"], one.get("note", ""))
        for key, one in document["camera"].items()
        if not key.startswith("sensitivity")
    }


def found(text: str) -> Path:
    """Return the file of the body that ``[camera] body`` names."""
    return kept(found_body(text).toml(), ".toml")
