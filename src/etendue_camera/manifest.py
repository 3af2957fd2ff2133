"""The manifest of etendue_camera: everything it provides, through the hooks that any distribution uses.

In:  the tables in ``data/``.
Out: stages, variables, camera quantities, sensors, roles and spectra by name; display order and display names.
"""

from __future__ import annotations

import csv
import tomllib
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

from etendue.api import hookimpl

if TYPE_CHECKING:
    from etendue.types.documents import Document

DATA = Path(__file__).parent / "data"
LIBRARY = "colour-science"  # instead of a path: a table of this library


def _table(name: str) -> Document:
    return tomllib.loads((DATA / f"{name}.toml").read_text(encoding="utf-8"))


@cache
def _shown() -> Document:
    return _table("shown")


@hookimpl
def etendue_stages() -> dict[str, str]:
    return {name: f"{module}:{kind}" for module, kinds in _table("stages").items() for name, kind in kinds.items()}


@hookimpl
def etendue_variables() -> Document:
    found = {name: dict(declared) for name, declared in _table("variables").items()}
    for word, names in _table("better").items():
        for name in names:
            found[name]["better"] = word
    for word, names in _table("subjects").items():
        for rank, name in enumerate(names):
            found[name] |= {"subject": word, "rank": rank}
    for name, words in _shown()["variables"].items():
        found[name] |= words
    for rank, names in _shown()["curve"].items():
        for name in names:
            found[name]["curve"] = int(rank)
    for word, names in _shown()["true"].items():
        for name in names:
            found[name][word] = True
    return found


@hookimpl
def etendue_quantities() -> Document:
    return _table("quantities")


@hookimpl
def etendue_sensors() -> dict[str, Path]:
    return {path.stem: path for path in (DATA / "sensors").glob("*.toml")}


@hookimpl
def etendue_roles() -> dict[str, str]:
    return _table("roles")


@hookimpl
def etendue_vocabularies() -> Document:
    return {
        # a TOML file as in data/sensors, or the same as a mapping: [camera] sensor = "NAME"
        "sensors": {"word": "sensor"},
        # these names are accepted wherever a path of a table is
        "spectra": {"word": "spectrum", "endings": (".csv", ".spdx"), "library": LIBRARY},
        "lens_profiles": {"word": "lens profile", "endings": (".lens",)},
    }


@hookimpl
def etendue_spectra() -> dict[str, str]:
    tables, measured = (
        csv.DictReader(line for line in (DATA / name).read_text(encoding="utf-8").splitlines() if line[0] != "#")
        for name in ("spectral_tables.csv", "cameras/sensitivities.csv")
    )
    library = {row["name"]: LIBRARY for row in tables if row["kind"] != "rgb_space"}
    cameras = {row["camera"]: str(DATA / "cameras" / "sensitivities" / row["file"]) for row in measured}
    return {"flat": LIBRARY, **library, **cameras}


@hookimpl
def etendue_dims() -> Document:
    return dict(_shown()["dims"])


@hookimpl
def etendue_units() -> dict[str, str]:
    return {"electron": "", "DN": ""}


@hookimpl
def etendue_patterns() -> dict[str, str]:
    return {"rng_sensor": "sensor_serial"}


@hookimpl
def etendue_commands() -> Document:
    return {
        "sensors": {
            "place": "etendue_camera.cli.catalogue:sensors",
            "usage": "[NAME]",
            "doc": "list sensors with published parameters",
        },
        "cameras": {
            "place": "etendue_camera.cli.catalogue:cameras",
            "usage": "[NAME]",
            "doc": "list, show and search cameras and lenses that exist",
        },
        "export": {
            "place": "etendue_camera.cli.exports:export",
            "usage": "DIR --dng",
            "doc": "write DNG raw files and pictures",
        },
        "import": {
            "place": "etendue_camera.cli.imports:take",
            "usage": "CUBE",
            "doc": "import a spectral cube as a scene",
        },
    }


@hookimpl
def etendue_methods() -> dict[str, str]:
    return {"Archive.export": "etendue_camera.export.archived:export"}


@hookimpl
def etendue_seen() -> dict[str, str]:
    return {name: f"etendue_camera.seen:of_{name}" for name in ("wavelength", "channel", "pattern")}


@hookimpl
def etendue_tables() -> Document:
    return {
        "camera": {
            "preset": "sensor",
            "presets": "sensors",
            "listed": "etendue sensors",
            "further": {
                "body": {"find": "etendue_camera.cameras.bodies:found", "listed": "etendue cameras"},
                "lens": {"find": "etendue_camera.cameras.lenses:found", "listed": "etendue cameras --lenses"},
            },
        }
    }


@hookimpl
def etendue_templates() -> Document:
    keep = {
        "all": "everything",
        "looks": "pictures and metrics, without spectral bands",
        "rgb_display": "the picture only",
    }
    return {"camera": {"path": DATA / "beginning.toml", "preset": "sony-imx363", "keep": keep}}


@hookimpl
def etendue_beginnings() -> Document:
    return _table("beginnings")


@hookimpl
def etendue_elsewhere() -> Document:
    return _table("plugins")


@hookimpl
def etendue_first() -> Document:
    return dict(_shown()["first"])


@hookimpl
def etendue_words() -> Document:
    return dict(_shown()["words"])


@hookimpl
def etendue_spelling() -> Document:
    return dict(_shown()["spelling"])


@hookimpl
def etendue_subjects() -> Document:
    return dict(_shown()["subjects"])


@hookimpl
def etendue_scales() -> Document:
    return dict(_shown()["units"])


@hookimpl
def etendue_examples() -> Document:
    return dict(_shown()["examples"])
