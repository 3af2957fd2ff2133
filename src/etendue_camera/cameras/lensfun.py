"""Read the XML files of a lensfun database: mounts, cameras, lenses.

In:  the content of a file, or of all files of a folder.
Out: ``Database``: every lens entry, either accepted or listed with its name and the reason of its refusal.
Source: the form of lensfun's database, versions 1 and 2.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from xml.etree import ElementTree
from xml.parsers import expat

from etendue import plain_files
from etendue_camera.cameras.names import brand, full_name
from etendue_camera.field.lens_calibration import MODELS, Lens, Point

LICENCE = "CC BY-SA 3.0"
LARGEST = 16 << 20  # bytes of one file
DEEPEST = 8  # nesting depth of elements; the database has five
_TERMS = {
    ("distortion", "poly3"): ("k1",),
    ("distortion", "poly5"): ("k1", "k2"),
    ("distortion", "ptlens"): ("a", "b", "c"),
    ("tca", "linear"): ("kr", "kb"),
    ("tca", "poly3"): ("vr", "vb", "cr", "cb", "br", "bb"),
    ("vignetting", "pa"): ("k1", "k2", "k3"),
}
_DEFAULTS = {"kr": 1.0, "kb": 1.0, "vr": 1.0, "vb": 1.0}
_FOCAL = re.compile(r"(?<!\d)(?<!\d\.)(\d+(?:\.\d+)?)(?:\s*-\s*(\d+(?:\.\d+)?))?\s*mm", re.IGNORECASE)
_APERTURE = re.compile(r"(?:f/|1:|(?<=mm)\s*f|\bf)\s*(\d+(?:\.\d+)?)", re.IGNORECASE)


@dataclass(frozen=True)
class Camera:
    """A camera of the database."""

    maker: str
    model: str
    mount: str
    crop_factor: float
    also: tuple[str, ...] = ()  # other names

    def name(self) -> str:
        return full_name(self.maker, self.model)


@dataclass
class Database:
    """The content of some files. ``refused``: the name of each entry that is not in ``lenses``, and the reason."""

    mounts: dict[str, tuple[str, ...]] = field(default_factory=dict)
    cameras: list[Camera] = field(default_factory=list)
    lenses: list[Lens] = field(default_factory=list)
    refused: list[tuple[str, str]] = field(default_factory=list)

    def bodies_of(self, mounts: Iterable[str]) -> tuple[str, ...]:
        """Return the mounts of bodies that take a lens with one of these mounts."""
        own = set(mounts)
        return tuple(sorted(own | {name for name, others in self.mounts.items() if own & set(others)}))

    def add(self, other: Database) -> None:
        self.mounts.update(other.mounts)
        self.cameras += other.cameras
        self.lenses += other.lenses
        self.refused += other.refused


def read_database(files: Iterable[Path]) -> Database:
    """Return the joint content of all these files.

    Raises
    ------
    ValueError
        If a file is not part of a lensfun database.
    """
    whole = Database()
    for path in sorted(files):
        try:
            whole.add(parsed(plain_files.content(path, LARGEST), path.name))
        except OSError as error:
            raise ValueError(f"{path.name} cannot be read: {error.strerror}") from None
    whole.lenses = [replace(one, fits=whole.bodies_of(one.mounts)) for one in whole.lenses]
    return whole


def parsed(data: bytes, name: str) -> Database:
    """Return the content of one file; XML entities, and elements nested deeper than in the database, are refused."""
    root = _tree(data, name)
    if root.tag != "lensdatabase":
        raise ValueError(f"{name} is not a lensfun database: its first element is <{root.tag[:40]}>")
    found = Database()
    for one in root:
        if one.tag == "mount":
            compatible = tuple(_texts(one, "compat"))
            found.mounts[_text(one, "name")] = compatible
        elif one.tag == "camera":
            _take_camera(one, found)
        elif one.tag == "lens":
            label = full_name(_text(one, "maker"), _text(one, "model")) or "a lens without a name"
            try:
                found.lenses.append(_lens(one))
            except ValueError as error:
                found.refused.append((label, str(error)))
    return found


def _tree(data: bytes, name: str) -> ElementTree.Element:
    """Return the root element of an XML text, parsed by expat without entities."""
    builder, depth = ElementTree.TreeBuilder(), 0
    parser = expat.ParserCreate()

    def refuse(*_: object) -> int:
        raise ValueError(f"{name} declares XML entities, which a Lensfun database does not contain")

    def start(tag: str, attributes: Mapping[str, str]) -> None:
        nonlocal depth
        depth += 1
        if depth > DEEPEST:
            raise ValueError(f"{name} is nested more than {DEEPEST} deep")
        builder.start(tag, dict(attributes))

    def end(tag: str) -> None:
        nonlocal depth
        depth -= 1
        builder.end(tag)

    parser.StartElementHandler, parser.EndElementHandler = start, end
    parser.CharacterDataHandler = builder.data
    parser.EntityDeclHandler = refuse
    parser.ExternalEntityRefHandler = refuse
    parser.UnparsedEntityDeclHandler = refuse
    try:
        parser.Parse(data, True)
    except expat.ExpatError as error:
        raise ValueError(f"{name} is not XML: {error}") from None
    except (LookupError, UnicodeError) as error:  # the declared encoding does not exist, or is not the actual one
        raise ValueError(f"{name} is not XML: {error}") from None
    return builder.close()


def _texts(one: ElementTree.Element, tag: str) -> list[str]:
    return [" ".join(part.text.split()) for part in one.iter(tag) if part.text and part.text.strip()]


def _text(one: ElementTree.Element, tag: str) -> str:
    """Return the text of the element's child with this tag: of several children, the one without a language, otherwise
    the first.
    """
    plain = [part for part in one.findall(tag) if part.get("lang") is None]
    found = plain or one.findall(tag)
    return " ".join((found[0].text or "").split())[:200] if found else ""


def _number(text: str | None, what: str, low: float, high: float) -> float:
    try:
        value = float(text or "")
    except ValueError:
        value = math.nan
    if not low <= value <= high:
        raise ValueError(f"{what} is {(text or '')[:40]!r}, expected {low:g} to {high:g}")
    return value


def _take_camera(one: ElementTree.Element, found: Database) -> None:
    maker, model = _text(one, "maker"), _text(one, "model")
    try:
        crop = _number(_text(one, "cropfactor"), "cropfactor", 0.05, 100.0)
    except ValueError as error:
        found.refused.append((full_name(maker, model), str(error)))
        return
    others = {full_name(maker, text) for text in _texts(one, "model")} - {full_name(maker, model)}
    found.cameras.append(Camera(brand(maker), model, _text(one, "mount"), crop, tuple(sorted(others))))


def _lens(one: ElementTree.Element) -> Lens:
    projection = _text(one, "type") or "rectilinear"
    if projection != "rectilinear":
        raise ValueError(f"its projection is {projection}; only rectilinear lenses can be used")
    maker, model = _text(one, "maker"), _text(one, "model")
    if not model:
        raise ValueError("it has no model")
    centre = one.find("center")
    if centre is not None and any(float(centre.get(axis, "0") or 0) for axis in ("x", "y")):
        raise ValueError("its centre is off the middle of the frame, which is not modelled")
    crop = _number(_text(one, "cropfactor"), "cropfactor", 0.05, 100.0)
    points: dict[str, tuple[Point, ...]] = {}
    for kind in MODELS:
        points[kind] = tuple(_point(kind, part) for part in one.iter(kind) if part.get("model", "none") != "none")
    focal, aperture = _ranges(one, model, points)
    return Lens(brand(maker), model, tuple(_texts(one, "mount")), (), crop, _aspect(one), focal, aperture, **points)


def _aspect(one: ElementTree.Element) -> float:
    text = _text(one, "aspect-ratio")
    if ":" in text:
        first, _, second = text.partition(":")
        value = _number(first, "aspect-ratio", 1e-3, 1e3) / _number(second, "aspect-ratio", 1e-3, 1e3)
    else:
        value = _number(text, "aspect-ratio", 0.1, 10.0) if text else 1.5
    return max(value, 1.0 / value)


def _point(kind: str, part: ElementTree.Element) -> Point:
    model = part.get("model", "")
    names = _TERMS.get((kind, model))
    if names is None:
        raise ValueError(f"its {kind} has the model {model!r}; known are {', '.join(MODELS[kind])}")
    terms = tuple(_number(part.get(term, str(_DEFAULTS.get(term, 0.0))), f"{kind} {term}", -1e4, 1e4) for term in names)
    focal = _number(part.get("focal"), f"focal of {kind}", 0.1, 1e5)
    if kind != "vignetting":
        return Point(model, terms, focal)
    aperture = _number(part.get("aperture"), "aperture of vignetting", 0.1, 1e3)
    return Point(model, terms, focal, aperture, _number(part.get("distance"), "distance of vignetting", 1e-3, 1e6))


def _ranges(
    one: ElementTree.Element, model: str, points: Mapping[str, tuple[Point, ...]]
) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return the ranges of focal length and aperture: as stated, otherwise from the name, otherwise from the
    calibrations.
    """
    named = {tag: one.find(tag) for tag in ("focal", "aperture")}
    focal, aperture = (_stated(element) for element in named.values())
    if focal is None and (match := _FOCAL.search(model)):
        focal = (float(match[1]), float(match[2] or match[1]))
    measured = [point.focal for own in points.values() for point in own]
    if focal is None or not 0 < focal[0] <= focal[1]:
        if not measured:
            raise ValueError("it has no focal length, in its name or its calibration")
        focal = (min(measured), max(measured))
    if aperture is None:
        match = _APERTURE.search(model)
        wide = float(match[1]) if match else min((point.aperture for point in points["vignetting"]), default=0.0)
        aperture = (wide, 0.0)
    return focal, aperture


def _stated(element: ElementTree.Element | None) -> tuple[float, float] | None:
    if element is None:
        return None
    if value := element.get("value"):
        number = _number(value, element.tag, 1e-2, 1e5)
        return number, number
    if not element.get("min"):
        return None
    low = _number(element.get("min"), element.tag, 1e-2, 1e5)
    return low, _number(element.get("max", element.get("min")), element.tag, 1e-2, 1e5)
