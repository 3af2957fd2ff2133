"""Laws that a whole camera obeys, whatever its values.

In:  a pipeline document whose stages have the names of their slots, and a function that runs one.
Out: for each law, the variants of the camera (twins) on which it is tested, and every violation.

bounded      everything is finite, unless declared undefined; display in [0, 1]; raw within the converter's codes
monotone     noise-free: more time or more light never darkens a pixel of the balanced mosaic, for any scene, or of the
             display, for a uniform scene
white        noise-free: a pixel is (1, 1, 1) if all raw pixels that affect it are clipped
neutral      a uniform grey card is grey on the display, at every exposure
flux         a uniform plane passes lens and diffusion unchanged: each pixel gains as much light as it loses
linear       ten times the light gives ten times the photocurrent
"""

from __future__ import annotations

import copy
import tomllib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib import resources
from typing import TYPE_CHECKING

import numpy as np
import scipy

from etendue.archive.read.differing import full_scale
from etendue.contract.registry import installed_stages
from etendue.contract.stage import parameters_of, writes_of
from etendue.testing import measured
from etendue.testing.bench import largest_difference
from etendue.types.arrays import Array, FloatArray
from etendue.types.documents import Document

if TYPE_CHECKING:
    import xarray

Run = Callable[[Document], "xarray.DataTree"]  # from a document to its tree

TIMES = tuple(10.0**k for k in range(-3, 4))
ROUNDING = 2e-5  # of full scale: float32 through transforms, matrices and encodings; a grey level of 8 bits is 4e-3
WORDS = tomllib.loads((resources.files("etendue_lab") / "data" / "camera_laws.toml").read_text(encoding="utf-8"))
STAND_IN, METER, ENCODED, FLAWED = WORDS["stand_in"], WORDS["metering"], WORDS["encoded"], WORDS["flawed"]
EXPOSING, UNEVEN, LOOKING = (tuple(WORDS[word]) for word in ("exposing", "uneven", "looking"))  # names of slots
SUPPORT = 17  # side of the square of raw pixels that can affect a pixel through a demosaicer; a generous bound
PERIOD = 6  # pixels: period of the longest mask, X-Trans
# The number of cone responses to white that were raised to a floor. Above 0, white is not the true one, and the laws
# `neutral` and `white` are not tested.
LIFTED = "adapt.cones_floored"
MATRIX = "fit.colour_matrix"
# largest element above which a colour matrix turns float32 rounding into colours; named as a cause in the report
STEEP = 1e4
GREY = 2e-3
FLUX, LINEAR = 5e-6, 1e-5  # relative to the largest value, in float32 through transforms
WHITE = 1e-6
ROUNDINGS, LARGEST = (
    8,
    1e3,
)  # roundings in the picture's precision, times the largest matrix element, at most this: allowed at (1, 1, 1)


@dataclass(frozen=True)
class Broken:
    """A law that a camera breaks."""

    law: str
    text: str
    document: Document | None = None  # the twin that showed it


def of(document: Document, slot: str) -> Document | None:
    return next((stage for stage in document["stages"] if stage["name"] == slot), None)


def twin(document: Document, wanted: list[str], axis: str, values: list[float]) -> Document:
    """Return the same camera noise-free and unrounded, with neutral highlights, swept along one axis.

    If the camera is metered, its time is swept; white is taken from the light, not from the picture.
    """
    made = copy.deepcopy(document)
    first = min(n for n, stage in enumerate(made["stages"]) if stage["name"] in (*EXPOSING, METER))
    kept = [stage for stage in made["stages"] if stage["name"] not in (*EXPOSING, METER, *LOOKING)]
    kept.insert(first, {"use": STAND_IN["noise_free"], "name": "ideal"})
    measures = next(n for n, stage in enumerate(kept) if stage["name"] == ENCODED) + 1
    made["stages"] = kept[:measures]
    for slot, words in (
        ("white", {"use": STAND_IN["known_white"]}),
        ("balanced", {"highlights": "neutral"}),
        ("to_xyz_scene", {"highlights": "neutral"}),
    ):
        if (stage := of(made, slot)) is not None:
            stage |= words
    made["wanted"], made["sweep"] = wanted, {axis: values}
    made["camera"].pop(axis, None)
    return made


def uniform(made: Document, reflectance: float = 0.4) -> Document:
    """Replace the scene by a uniform grey one, remove optics that make it uneven, and use the display's white."""
    scene = of(made, "scene")
    assert scene is not None
    own = {*parameters_of(installed_stages().load(STAND_IN["flat_scene"])), "name"}
    kept = {name: value for name, value in scene.items() if name in own}
    made["stages"] = [stage for stage in made["stages"] if stage["name"] not in UNEVEN]
    made["stages"][0] = {**kept, "use": STAND_IN["flat_scene"], "reflectance": reflectance}
    display = (of(made, "display") or {}).get("display", "sRGB")
    for slot, words in (("fit", {"white": "kept"}), ("adapt", {"target": display, "gains": "white"})):
        stage = of(made, slot)
        assert stage is not None
        stage |= words
    lens = of(made, "lens")
    if lens is not None and lens["use"] == STAND_IN["by_source"]:
        lens["weights"] = "image"  # 'source' keeps a point's flux, but a plane only as uniform as the pictures are
    return made


def laws(document: Document, tree: xarray.DataTree, run: Run) -> Iterator[Broken]:
    """Yield every law that a camera breaks; ``tree`` is the result of running the unchanged camera."""
    yield from bounded(document, tree)
    yield from told("monotone", over_time(document), run, any_scene)
    yield from told("neutral", grey_over(document, "integration_time"), run, grey_card)
    yield from told("neutral", grey_over(document, "scene.white_luminance"), run, grey_card)
    yield from told("flux", even(document), run, flux)
    yield from told("linear", light(document), run, linear)


def told(
    law: str, made: Document, run: Run, judge: Callable[[Document, xarray.DataTree], Iterator[Broken]]
) -> Iterator[Broken]:
    try:
        tree = run(made)
    except Refused as refused:  # the plan refused the twin, although it differs only in scene, time or light
        yield Broken(law, f"twin refused: {refused}", made)
        return
    except Failure as fault:
        yield Broken(fault.kind, str(fault), made)
        return
    for broken in judge(made, tree):
        yield Broken(broken.law, broken.text, made)


class Refused(Exception):
    """The plan refused the camera with a reason."""


class Failure(Exception):
    """The camera failed: a failed cell, a warning, or an unexpected exception."""

    def __init__(self, kind: str, text: str) -> None:
        self.kind = kind
        super().__init__(text)


def array(tree: xarray.DataTree, stage: str, variable: str) -> Array:
    """Return the array of a variable from the tree of a run."""
    return np.asarray(tree[stage][variable].values)


# ----------------------------------------------------------------------------------------------------- bounded


def bounded(document: Document, tree: xarray.DataTree) -> Iterator[Broken]:
    registry = installed_stages()
    top = 2 ** document["camera"]["bits"] - 1
    for stage in document["stages"]:
        for variable, declared in writes_of(registry.load(stage["use"])).items():
            if stage["name"] not in tree or variable not in tree[stage["name"]]:
                continue
            found = array(tree, stage["name"], variable)
            if found.dtype.kind == "f" and not declared.nan and not np.isfinite(found).all():
                yield Broken("bounded", f"{stage['name']}.{variable} is not finite")
            if variable == "raw" and (found.min() < 0 or found.max() > top):
                yield Broken(
                    "bounded", f"raw ranges from {found.min()} to {found.max()}; the converter has codes 0 to {top}"
                )
            if variable == "rgb_display" and not (found.min() >= 0 and found.max() <= 1):
                yield Broken("bounded", f"rgb_display ranges from {found.min():g} to {found.max():g}")


# ------------------------------------------------------------------------------------------- time, light, white


def over_time(document: Document) -> Document:
    """Return the noise-free camera swept over seven exposure times around its own."""
    time = document["camera"].get("integration_time", 0.01)
    wanted = ["ideal.mosaic_linear", "encode.rgb_display"]
    made = twin(document, [*wanted, LIFTED, MATRIX], "integration_time", [time * k for k in TIMES])
    last = [stage["name"] for stage in made["stages"] if stage["name"] in ("ideal", "shading", "balanced")][-1]
    made["wanted"] = list(dict.fromkeys([*made["wanted"], f"{last}.mosaic_linear"]))
    return made


def any_scene(made: Document, tree: xarray.DataTree) -> Iterator[Broken]:
    mosaic = array(tree, "ideal", "mosaic_linear")
    for place in made["wanted"]:
        stage, _, variable = place.partition(".")
        if variable == "mosaic_linear":
            yield from monotone(array(tree, stage, variable), place, "time")
    display = array(tree, ENCODED, "rgb_display")
    support = scipy.ndimage.minimum_filter(mosaic, size=(1, SUPPORT, SUPPORT), mode="nearest") >= 1 - 1e-6
    adapted, shown, fitted = (of(made, name) or {} for name in ("adapt", "display", "fit"))
    # White is (1, 1, 1) only if the scene is balanced to the white of its display.
    same_white = adapted.get("target", "D65") == shown.get("display", "sRGB") and fitted.get("white", "kept") == "kept"
    if same_white and not array(tree, *LIFTED.split(".")).any():
        yield from white(display, support, float(np.abs(array(tree, *MATRIX.split("."))).max()))


def grey_over(document: Document, axis: str) -> Document:
    """Return the camera viewing a grey card, swept over seven exposure times or seven light levels."""
    now = document["camera"].get(axis, 0.01) if axis == "integration_time" else of(document, "scene")["white_luminance"]  # type: ignore[index]
    made = uniform(
        twin(document, ["ideal.mosaic_linear", "encode.rgb_display", LIFTED, MATRIX], axis, [now * k for k in TIMES])
    )
    if "." in axis:
        made["stages"][0].pop("white_luminance")
    return made


def grey_card(made: Document, tree: xarray.DataTree) -> Iterator[Broken]:
    what = "time" if "integration_time" in made["sweep"] else "light"
    mosaic, display = array(tree, "ideal", "mosaic_linear"), array(tree, ENCODED, "rgb_display")
    largest = float(np.abs(array(tree, *MATRIX.split("."))).max())
    behind = steep(largest)
    yield from monotone(display, f"encode.rgb_display of a grey card{behind}", what, rounding(display, largest))
    wanders = made["camera"].get("crosstalk") == "through_filter"
    if array(tree, *LIFTED.split(".")).any() or (wanders and min(display.shape[2:]) < PERIOD):
        return  # a frame smaller than the mask's period lacks the neighbours assumed for the white
    apart = (display.max(axis=1) - display.min(axis=1)).max(axis=(1, 2))
    if wanders:
        # sites of one filter have different neighbours, so that a plane is not uniform: only its mean is grey, up to
        # the differences between sites
        means = display.mean(axis=(2, 3))
        apart = np.ptp(means, axis=1) - np.ptp(display, axis=(2, 3)).max(axis=1)
    measured.told(float(apart.max()), GREY)
    for step, value in enumerate(apart):
        if value > GREY:
            seen = ", ".join(f"{v:.4f}" for v in display[step].mean(axis=(1, 2)))
            share = float((mosaic[step] >= 1 - 1e-6).mean())
            state = "fully clipped" if share == 1 else "not clipped" if share == 0 else "partly clipped"
            yield Broken(
                "neutral",
                f"a grey card{behind} {state} is ({seen}) at {what} x {TIMES[step]:g}: channels differ by {value:.3g}",
            )
            break
    clipped = np.broadcast_to((mosaic >= 1 - 1e-6).all(axis=(1, 2), keepdims=True), mosaic.shape)
    yield from white(display, clipped, largest)


def monotone(found: FloatArray, place: str, what: str, allowed: float = 0.0) -> Iterator[Broken]:
    """Check that values do not decrease along the first axis, except by rounding."""
    falls = -np.diff(found.astype(np.float64), axis=0)
    scale = max(1.0, float(np.abs(found).max())) if found.size else 1.0
    if falls.size:
        measured.told(max(float(falls.max()), 0.0) / scale, ROUNDING + allowed / scale)
    if falls.size and falls.max() > ROUNDING * scale + allowed:
        at = np.unravel_index(int(falls.argmax()), falls.shape)
        before, after = (float(found[(at[0] + i, *at[1:])]) for i in (0, 1))
        yield Broken(
            "monotone",
            f"{place} falls from {before:.6g} to {after:.6g} between {what} x {TIMES[at[0]]:g} and x "
            f"{TIMES[at[0] + 1]:g}",
        )


def white(display: FloatArray, clipped: Array, largest: float) -> Iterator[Broken]:
    """Check that the picture (time, channel, y, x) is white, (1, 1, 1), at each pixel at which all raw pixels that
    affect it are clipped; the mask (time, y, x) marks these pixels. The largest element of the colour matrix sets the
    allowed rounding error.
    """
    allowed = WHITE + rounding(display, largest)
    away = np.abs(display - 1).max(axis=1)
    away = np.where(clipped, away, 0)
    measured.told(float(away.max(initial=0.0)), allowed)
    if away.size and away.max() > allowed:
        step, row, column = np.unravel_index(int(away.argmax()), away.shape)
        seen = ", ".join(f"{v:.6f}" for v in display[step, :, row, column])
        yield Broken("white", f"a pixel{steep(largest)} whose support is all clipped is ({seen}) at x {TIMES[step]:g}")


def rounding(display: FloatArray, largest: float) -> float:
    """Return the rounding error after a colour matrix whose largest element is given, in the precision of the picture:
    at most 1e-3, a quarter of an 8-bit code.
    """
    return ROUNDINGS * float(np.finfo(display.dtype).eps) * min(largest, LARGEST)


def steep(largest: float) -> str:
    """Return a remark if a colour matrix amplifies rounding; '' otherwise."""
    return f" after a colour matrix with elements up to {largest:.1g}" if largest > STEEP else ""


# -------------------------------------------------------------------------------------------------- flux, light


def cut_behind(made: Document, slot: str) -> Document:
    """Return the camera without the stages after a slot."""
    last = [stage["name"] for stage in made["stages"]].index(slot)
    made["stages"] = made["stages"][: last + 1]
    return made


def even(document: Document) -> Document:
    """Return the camera viewing a uniform plane, cut after the last of lens, low-pass and diffusion, without stages
    that absorb or scatter light.
    """
    made = uniform(twin(document, [], "scene.white_luminance", [of(document, "scene")["white_luminance"]]))  # type: ignore[index]
    names = [stage["name"] for stage in made["stages"]]
    last = [name for name in names if name in ("irradiance", "lens", "low_pass", "diffusion")][-1]
    made = cut_behind(made, last)
    made["stages"] = [stage for stage in made["stages"] if stage["name"] not in ("filter", "glare")]
    made["wanted"] = list(dict.fromkeys(["irradiance.irradiance", f"{last}.irradiance"]))
    made.pop("sweep")
    made["camera"] = {name: value for name, value in made["camera"].items() if name != "integration_time"}
    return made


def flux(made: Document, tree: xarray.DataTree) -> Iterator[Broken]:
    first, last = (array(tree, place.partition(".")[0], "irradiance") for place in (made["wanted"] * 2)[:2])
    away = measured.ratio_of(largest_difference(last, first), full_scale(first))
    measured.told(away, FLUX)
    if away > FLUX:
        behind = made["wanted"][-1].partition(".")[0]
        yield Broken("flux", f"a uniform plane changes by {away:.3g} of its value up to {behind}")


def light(document: Document) -> Document:
    """Return the camera up to the mosaic, swept over two light levels that differ by a factor of ten."""
    level = of(document, "scene")["white_luminance"]  # type: ignore[index]
    made = twin(document, ["cfa.photocurrent"], "scene.white_luminance", [level, 10 * level])
    made["stages"][0].pop("white_luminance")
    made = cut_behind(made, "cfa")
    made["stages"] = [stage for stage in made["stages"] if stage["name"] != FLAWED]
    return made


def linear(made: Document, tree: xarray.DataTree) -> Iterator[Broken]:
    once, ten = array(tree, "cfa", "photocurrent").astype(np.float64)
    away = measured.ratio_of(largest_difference(ten, 10 * once), full_scale(ten))
    measured.told(away, LINEAR)
    if away > LINEAR:
        yield Broken(
            "linear",
            f"the current for ten times the light differs from ten times the current by {away:.3g} of its maximum",
        )
