"""Whole cameras at extremes: each must give a finite result that obeys the laws, or be refused by the plan with one
clear message.

In:  nothing: ``data/extreme_camera.toml``, and changes to it.
Out: a row for every camera and law. If the plan refuses, its message; never a failed cell, a warning, a traceback or
     NaN.
"""

from __future__ import annotations

import copy
import math
import tomllib
import warnings
from collections.abc import Callable, Iterator
from functools import cache
from importlib import resources
from typing import Any

import numpy as np

from etendue.builder.simulating import simulate
from etendue.errors import EtendueError, PluginError, RequestError
from etendue.telling import said
from etendue.testing.cases import sobol
from etendue.testing.measured import measuring
from etendue.types.documents import Document
from etendue_lab.stability import camera_laws
from etendue_lab.stability.camera_laws import STAND_IN, Broken, Failure, Refused, of
from etendue_lab.stability.rows import LawCase

STAGE = "whole camera"
RUNS = "runs or is refused"
DRAWN = 64
FRAMES = ((1, 1), (1, 7), (7, 1), (2, 2), (3, 5), (17, 31))
EXTREMES: dict[str, tuple[float, ...]] = {  # extreme values, tried for one camera quantity at a time
    "f_number": (0.5, 0.7, 1.0, 22.0, 128.0, 1e4, 1e6),
    "pixel_pitch": (0.1, 0.5, 1.1, 30.0, 1000.0),
    "integration_time": (1e-9, 1e-6, 1.0, 1e3, 1e6),
    "focal_length": (0.01, 1e5),
    "magnification": (-1e3, -1.0, -1e-6),
    "transmittance": (1e-9,),
    "aperture_fraction": (0.001, 1.0),
    "diffusion_depth": (1e-3, 1e4, math.inf),
    "diffusion_length": (1e-3, 1e6, math.inf),
    "depletion_depth": (1e-3, 1e3),
    "surface_transmission": (1e-9,),
    "full_well_density": (1e-2, 1.0, 1e9),
    "dark_current_density": (0.0, 1e-4, 1.0),
    "temperature": (150.0, 450.0),
    "analogue_gain": (1e-4, 1e4),
    "read_noise": (0.0, 1e-6, 1e6),
    "read_noise_after": (1e6,),
    "dsnu": (0.0, 1e6),
    "bits": (1, 16),
    "black_level": (0,),
    "conversion_gain": (1e-9, 1e6),
    "render_exposure": (1e-6, 1e6),
}
CHARGES = (1.0, 10.0, 1e3, 1e6, 1e9)  # electrons of a white pixel
LUMINANCES = (1e-12, 1e-3, 1e6, 1e12)
WORDS = {  # text values of camera quantities, one extreme each
    "crosstalk": "through_filter",
    "noise": "common",
    "aperture_model": "flat_disc",
    "brightness": "camera",
    "back": "reflecting",
    "illuminant": "500 K",
}
RANGES = {  # ranges from which cameras are drawn, on a logarithmic scale
    "f_number": (0.5, 1e6),
    "pixel_pitch": (0.1, 1000.0),
    "integration_time": (1e-9, 1e6),
    "focal_length": (0.1, 1e4),
    "aperture_fraction": (0.01, 1.0),
    "full_well_density": (1e-1, 1e9),
    "dark_current_density": (1e-14, 1e-3),
    "diffusion_length": (1e-2, 1e5),
    "diffusion_depth": (1e-2, 1e4),
    "read_noise": (1e-3, 1e4),
    "luminance": (1e-9, 1e12),
    "dark": (1e-8, 1.0),
}


def base() -> Document:
    """Return the unchanged camera."""
    return tomllib.loads((resources.files("etendue_lab") / "data" / "extreme_camera.toml").read_text(encoding="utf-8"))


def changed(
    scene: Document | None = None, quantities: Document | None = None, frame: tuple[int, int] | None = None
) -> Document:
    """Return the camera with other quantities, another scene or another frame size. The grid of the light covers all
    pixels, with two samples per pixel along each axis.
    """
    made = base()
    made["camera"] |= {name: "inf" if value == math.inf else value for name, value in (quantities or {}).items()}
    lit, pixel = of(made, "scene"), of(made, "pixel")
    assert lit is not None
    assert pixel is not None
    rows, columns = frame or (pixel["rows"], pixel["columns"])
    pixel |= {"rows": rows, "columns": columns}
    pitch = float(made["camera"]["pixel_pitch"])
    lit |= {"height": pitch * (rows + 3), "width": pitch * (columns + 2), "spacing": 0.5 * pitch}
    lit |= scene or {}
    if made["camera"].get("crosstalk") == "through_filter":
        made["stages"] = [stage for stage in made["stages"] if stage["name"] != "diffusion"]
        place = next(n for n, stage in enumerate(made["stages"]) if stage["name"] == "cfa")
        made["stages"].insert(place + 1, {"use": STAND_IN["behind_filters"], "name": "behind_filters"})
    return made


def scene(use: str, **words: Any) -> Document:
    return {"use": use, **words}


def cameras() -> Iterator[tuple[str, Document]]:
    """Yield every camera, by name."""
    yield "ordinary", changed()
    for name, values in EXTREMES.items():
        for value in values:
            yield f"{name} = {value:g}", changed(quantities={name: value})
    for charge in CHARGES:
        words = {"white_luminance": of(base(), "scene")["white_luminance"] * charge / white_charge()}  # type: ignore[index]
        name = "1 electron" if charge == 1 else f"{charge:g} electrons"
        yield f"white of {name}", changed(words)
        yield (
            f"white of {name} in a well that holds it",
            changed(words, {"full_well_density": min(1e9, max(1.0, charge / 10))}),
        )
    for luminance in LUMINANCES:
        yield f"luminance {luminance:g} cd m-2", changed({"white_luminance": luminance})
    for name, word in WORDS.items():
        yield f"{name} = {word}", changed(quantities={name: word})
    yield "through filters of 0.1 um", changed(quantities={"crosstalk": "through_filter", "pixel_pitch": 0.1})
    yield from scenes()
    for frame in FRAMES:
        yield f"{frame[0]} x {frame[1]} pixels", changed(frame=frame)
        yield f"{frame[0]} x {frame[1]} pixels, X-Trans", without_bayer(changed(frame=frame))
    for precision in ("float32", "float64"):
        yield f"scene of 1e8 : 1 in {precision}", {**changed({"low": 1e-8, "high": 1.0}), "precision": precision}
    for number, share in enumerate(sobol(len(RANGES), DRAWN)):
        yield f"drawn {number + 1}", drawn(share)


def scenes() -> Iterator[tuple[str, Document]]:
    """Yield scenes: black, saturated, of high contrast, in few and in many bands."""
    yield "black scene", changed(scene(STAND_IN["flat_scene"], reflectance=0.0))
    yield (
        "black scene, no dark current, no noise",
        changed(
            scene(STAND_IN["flat_scene"], reflectance=0.0),
            {"dark_current_density": 0.0, "read_noise": 0.0, "dsnu": 0.0},
        ),
    )
    yield "saturated everywhere", changed(scene(STAND_IN["flat_scene"], reflectance=1.0), {"integration_time": 1e3})
    yield "scene of 1e8 : 1", changed({"low": 1e-8, "high": 1.0})
    yield "scene of 1e8 : 1, saturated", changed({"low": 1e-8, "high": 1.0}, {"integration_time": 1e4})
    yield "scene of 1 : 0", changed({"low": 0.0, "high": 1.0})
    yield "points on black", changed(scene(STAND_IN["spots"], background=0.0, pitch=27.0, spot_sigma=2.7))
    yield "1 band", changed({"bin_width": 300.0})
    yield "1 band, no colour", {**changed({"bin_width": 300.0}), "wanted": ["convert.raw", "demosaic.rgb_camera"]}
    yield "300 bands", changed({"bin_width": 1.0})
    yield "1 band of 1 nm", changed({"wavelength_from": 550.0, "wavelength_to": 551.0, "bin_width": 1.0})
    yield "infrared alone", changed({"wavelength_from": 790.0, "wavelength_to": 830.0, "bin_width": 10.0})
    daylight = {"illuminant": "D65"}
    yield (
        "daylight beyond silicon",
        changed({"wavelength_from": 1150.0, "wavelength_to": 1250.0, "bin_width": 10.0}, daylight),
    )
    yield (
        "daylight to beyond silicon",
        changed({"wavelength_from": 380.0, "wavelength_to": 1300.0, "bin_width": 20.0}, daylight),
    )
    yield (
        "daylight below silicon",
        changed({"wavelength_from": 250.0, "wavelength_to": 400.0, "bin_width": 10.0}, daylight),
    )
    yield (
        "hot points on black",
        changed(scene(STAND_IN["spots"], background=0.0, pitch=54.0, spot_sigma=0.5), {}, (9, 12)),
    )
    yield "hard edges as cells", changed({"light": "cells", "softness": 0.0})


def without_bayer(made: Document) -> Document:
    made["camera"]["pattern"] = "X-Trans"
    stage = of(made, "demosaic")
    assert stage is not None
    stage["use"] = STAND_IN["any_mask"]
    return made


def drawn(shares: list[float]) -> Document:
    """Return a camera with quantities inside their extreme ranges; ``shares`` gives the position of each in its range,
    on a logarithmic scale.
    """
    values = {
        name: float(f"{math.exp(math.log(low) + share * math.log(high / low)):.6g}")
        for (name, (low, high)), share in zip(RANGES.items(), shares, strict=True)
    }
    lit = {"white_luminance": values.pop("luminance"), "low": values.pop("dark"), "high": 1.0}
    return changed(lit, values)


@cache
def white_charge() -> float:
    """Return the electrons of the brightest pixel of the unchanged camera."""
    made = changed(scene(STAND_IN["flat_scene"], reflectance=1.0))
    return float(
        np.max(camera_laws.array(run({**made, "wanted": ["expose.expected_charge"]}), "expose", "expected_charge"))
    )


def run(document: Document, errors: bool = True) -> Any:
    """Run a camera on one thread and return its tree, with the errors of wanted variables unless ``errors`` is False.

    Raises
    ------
    Refused
        The plan refuses the camera with a message.
    Fault
        A failed cell, a warning, or an unexpected exception.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            return simulate(document, scheduler="serial", errors=errors)
    except RequestError as error:
        raise Refused("; ".join(dict.fromkeys(f"{fault.place}: {fault.message}" for fault in error.faults))) from None
    except PluginError as error:
        raise Failure("failed cell", str(error).strip().rpartition("\n")[2]) from None
    except EtendueError as error:
        raise Refused(str(error)) from None
    except Warning as warning:
        raise Failure("leaked warning", f"{type(warning).__name__}: {warning}") from None
    except Exception as error:
        raise Failure("traceback", said(error)) from error


def rows_of_camera(name: str, document: Document) -> Iterator[LawCase]:
    try:
        tree = run(copy.deepcopy(document))
    except Refused as refused:
        yield LawCase(STAGE, RUNS, name, True, why=f"refused: {refused}")
        return
    except Failure as fault:
        yield LawCase(STAGE, RUNS, name, False, why=f"{fault.kind}: {fault}")
        return
    yield from judged(RUNS, name, lambda: list(camera_laws.bounded(document, tree)))
    for law, make, judge in (
        ("monotone in time", camera_laws.over_time, camera_laws.any_scene),
        ("grey at every time", lambda d: camera_laws.grey_over(d, "integration_time"), camera_laws.grey_card),
        ("grey in every light", lambda d: camera_laws.grey_over(d, "scene.white_luminance"), camera_laws.grey_card),
        ("flux kept", camera_laws.even, camera_laws.flux),
        ("linear in light", camera_laws.light, camera_laws.linear),
    ):
        yield from judged(law, name, lambda make=make, judge=judge: broken(make(copy.deepcopy(document)), judge))  # type: ignore[misc]


def broken(made: Document, judge: Callable[[Document, Any], Iterator[Broken]]) -> list[Broken]:
    """Return the laws that a twin breaks. Only the variables that the law examines are kept, and errors are not
    computed.
    """
    return list(judge(made, run({**made, "keep": made["wanted"]}, errors=False)))


def judged(law: str, name: str, check: Callable[[], list[Broken]]) -> Iterator[LawCase]:
    with measuring() as found:
        try:
            several = check()
        except Refused as refused:
            yield LawCase(STAGE, law, name, True, why=f"refused: {refused}")
            return
        except Failure as fault:
            yield LawCase(STAGE, law, name, False, why=f"{fault.kind}: {fault}")
            return
    yield LawCase(
        STAGE, law, name, not several, found.error, found.bound, found.condition, "; ".join(b.text for b in several)
    )
