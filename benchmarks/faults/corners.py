"""Run a tiny camera with each quantity and each stage parameter at the ends of its range, one at a time.

In:  `camera`, names of stages, or nothing: all (about ten minutes).
Out: a line for each corner that neither runs nor is refused by the plan: failed cells, tracebacks, warnings, more than
     10 s; then the counts.

    python benchmarks/faults/corners.py camera
"""

from __future__ import annotations

import copy
import signal
import sys
import tomllib
import traceback
import warnings
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any, get_args, get_origin

from etendue.contract.capabilities import is_source
from etendue.contract.registry import installed_stages
from etendue.contract.stage import parameters_of, reads_of, writes_of
from etendue.contract.values import quantities as camera
from etendue.contract.values.parameter import Parameter
from etendue.errors import MachineError, RequestError
from etendue.pipeline.file import from_document
from etendue.plan.planner import make_plan
from etendue.session import Options, execute

SMALLEST = Path(__file__).parents[2] / "pipelines" / "smallest.toml"
BEHIND = {
    "irradiance": "falloff",
    "mosaic_linear": "linearise",
    "rgb_camera": "sharpen",
    "charge": "shot_noise",
    "expected_charge": "exposure",
    "rgb_linear": "display",
    "xyz_scene": "camera_to_xyz",
    "raw": "adc",
}
LENSES = ("lens_gaussian", "lens_psf", "lens_psf_field", "wavefront", "aberrations")
SLOWEST = 10  # seconds


class Slow(BaseException):
    """Raised by the alarm."""


def tiny() -> dict[str, Any]:
    """Return the smallest pipeline on 16 x 16 pixels, without a sweep."""
    document = tomllib.loads(SMALLEST.read_text(encoding="utf-8"))
    document["sweep"] = {}
    document["camera"] |= {"pixel_pitch": 5.4, "integration_time": 0.004, "f_number": 2.8}
    document["stages"][0] |= {"width": 120, "height": 120, "spacing": 2, "bin_width": 50}
    next(s for s in document["stages"] if s["use"] == "pixel").update(rows=16, columns=16)
    return document


def holding(use: str, extra: dict[str, Any]) -> dict[str, Any]:
    """Return the tiny camera with a stage in its place, or after all others."""
    document = tiny()
    stages, kind = document["stages"], installed_stages().load(use)
    uses = [stage["use"] for stage in stages]

    def replace(old: str) -> dict[str, Any]:
        at = uses.index(old)
        stages[at] = {"use": use, "name": stages[at].get("name", old), **extra}
        return document

    if use in uses:
        stages[uses.index(use)].update(extra)
        return document
    if is_source(kind):
        shared = {key: value for key, value in stages[0].items() if key in parameters_of(kind)}
        stages[0] = {"use": use, "name": "scene", **shared, **extra}
        return document
    if use.startswith("demosaic"):
        return replace("demosaic_colour_difference")
    if use in LENSES:
        return replace("diffraction")
    if use == "white_estimate":
        return replace("white")
    if use in ("meter", "bracket"):
        stages.insert(uses.index("exposure"), {"use": use, **extra})
        return document
    if use == "merge_frames":
        stages.insert(uses.index("exposure"), {"use": "bracket", "brackets": [0, -1]})
        stages.insert([stage["use"] for stage in stages].index("demosaic_colour_difference") + 1, {"use": use, **extra})
        return document
    if use == "crosstalk":
        document["camera"]["crosstalk"] = "through_filter"
        stages.insert(uses.index("mosaic") + 1, {"use": use, **extra})
        del stages[uses.index("diffusion")]
        return document
    both = {d.variable for d in reads_of(kind).values()} & {d.variable for d in writes_of(kind).values()}
    place = next((uses.index(BEHIND[v]) + 1 for v in BEHIND if v in both), len(stages))
    stages.insert(place, {"use": use, **extra})
    return document


def corners(parameter: Parameter, kind: Any) -> list[Any]:
    """Return values at the ends of what a parameter allows; if it has no end, numbers that no camera has."""
    if kind is bool:
        return [True, False]
    several = get_origin(kind) is tuple
    kind = get_args(kind)[0] if several else kind
    found: list[Any] = []
    if kind in (int, float):
        step = 1 if kind is int else 1e-30
        low = parameter.at_least if parameter.at_least is not None else parameter.above
        high = parameter.at_most if parameter.at_most is not None else parameter.below
        for end, outwards, open_ in ((low, -1, parameter.above is not None), (high, 1, parameter.below is not None)):
            if end is None:
                found += [outwards * v for v in ((1e3, 1e12, 1e30) if kind is float else (10**3, 10**9))]
            elif open_ and (kind is int or not end):
                found.append(end - outwards * step)
            else:
                found.append(end * (1 - outwards * 1e-12 * (1 if end > 0 else -1)) if open_ else end)
        found += ([0] if parameter.allows(0) else []) + (["inf"] if parameter.infinite else [])
        found = list(dict.fromkeys(int(v) if kind is int else v for v in found))
    elif parameter.choices:
        found = list(parameter.choices)
    else:
        found = ["", "x", "nothing.csv"]
    if several:
        length = parameter.length or 3
        return [[v] * length for v in found] + [[found[0]] + [found[-1]] * (length - 1), []]
    return found


def outcome(document: dict[str, Any]) -> tuple[str, str]:
    """Return the outcome of a pipeline: ran, refused, machine (too large), failed (a cell, with a message), or a fault
    of ours.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            done = execute(
                make_plan(from_document(document), installed_stages()),
                None,
                Options(scheduler="serial", pictures=False),
            )
    except RequestError as error:
        return "refused", str(error)
    except MachineError as error:
        return "machine", str(error)
    except Slow:
        return "slow", ""
    except Exception:
        return "TRACEBACK", traceback.format_exc()
    if not done.failed:
        return "ran", ""
    first = done.failed[0]
    return ("FAILED WITH A TRACEBACK" if "Traceback" in first.message else "failed"), f"{first.stage}: {first.message}"


def cases(names: list[str]) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield every corner of the camera and of some stages: its name and the pipeline."""
    registry = installed_stages()
    if "camera" in names:
        kinds = {
            name: entry[1] for use in registry.names() for name, entry in parameters_of(registry.load(use)).items()
        }
        for name in camera.names():
            for value in corners(camera.declared(name), kinds[name]):
                document = tiny()
                document["camera"][name] = value
                yield f"camera.{name} = {value}", document
    for use in registry.names():
        if use not in names:
            continue
        yield use, holding(use, {})
        for name, (parameter, kind, _) in parameters_of(registry.load(use)).items():
            for value in [] if parameter.shared else corners(parameter, kind):
                yield f"{use}.{name} = {value}", holding(use, {name: copy.deepcopy(value)})


def main() -> None:
    def stop(*_: object) -> None:
        raise Slow

    signal.signal(signal.SIGALRM, stop)
    counts: Counter[str] = Counter()
    for name, document in cases(sys.argv[1:] or ["camera", *installed_stages().names()]):
        signal.alarm(SLOWEST)
        what, said = outcome(document)
        signal.alarm(0)
        counts[what] += 1
        if what not in ("ran", "refused"):
            print(f"{what}: {name}: {said.strip()[-600:]}", flush=True)
    print(dict(counts))
    raise SystemExit(any(what.isupper() for what in counts))


if __name__ == "__main__":
    main()
