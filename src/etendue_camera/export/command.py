"""What ``etendue export`` does: which cells, which files, and nothing half written.

In:  the folder of an archive, what was asked for.
Out: files; what was written and what could not be.
"""

from __future__ import annotations

import importlib.metadata
import os
import re
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from etendue.contract.registry import installed_stages
from etendue.errors import Fault, RequestError
from etendue.present.plots.places import is_called, read_at
from etendue_camera.electronics import amplifier
from etendue_camera.export import dng, png, tiff
from etendue_camera.export.frames import FINISHED, Frame, Shelf, chosen, described, plain
from etendue_camera.export.masks import mask_of, note
from etendue_camera.roles import BALANCE, FULL_WELL

MANY = 64
WELL = ("pixel_pitch", "aperture_fraction", "full_well_density")
GAIN = ("analogue_gain", "iso", "base_iso")
SUFFIXES = {"dng": (".dng",), "tiff": (".tif", ".tiff"), "png": (".png",)}


@dataclass(frozen=True)
class Request:
    """The words of the command line."""

    archive: Path
    dng: bool = False
    tiff: bool = False
    png: bool = False
    variables: tuple[str, ...] = ()  # of the TIFF and PNG files; none: raw, and the display values as PNG
    at: tuple[str, ...] = ()
    stage: str = ""
    output: Path | None = None
    all: bool = False
    force: bool = False


@dataclass
class Exported:
    """What became of a request."""

    folder: Path
    files: list[Path] = field(default_factory=list)
    skipped: list[tuple[str, str]] = field(default_factory=list)  # which picture, and why
    notes: list[str] = field(default_factory=list)


@dataclass(frozen=True)
class _Job:
    frame: Frame
    kind: str
    path: Path


def export(request: Request) -> Exported:
    """Write every picture that was asked for.

    Raises
    ------
    RequestError
        Nothing asked for, no such axis, value, stage or variable; a mask that DNG cannot say; a file that is there.
    ArchiveError
        Not an archive, or damaged.
    """
    if not request.dng and not request.tiff and not request.png:
        raise RequestError("say what to write: --dng, --tiff, --png or several of them")
    if request.variables and not request.tiff and not request.png:
        raise RequestError("--variable is for --tiff and --png; a DNG file is always of raw")
    shelf = Shelf(request.archive)
    at = read_at(request.at)
    wanted = [("dng", "raw")] if request.dng else []
    wanted += [("tiff", variable) for variable in dict.fromkeys(request.variables or ("raw",))] if request.tiff else []
    wanted += (
        [("png", variable) for variable in dict.fromkeys(request.variables or ("rgb_display",))] if request.png else []
    )
    stages = {variable: request.stage if len(wanted) == 1 or variable == "raw" else "" for _, variable in wanted}
    light = {variable for kind, variable in wanted if kind == "png"}  # bands of light are one picture in a PNG alone
    frames = {
        variable: shelf.frames(variable, stages[variable], variable in light and not request.tiff)
        for _, variable in wanted
    }
    own = {variable: {k: v for k, v in at.items() if _has(found, k)} for variable, found in frames.items()}
    unused = {k: v for k, v in at.items() if not any(k in taken for taken in own.values())}
    if unused:
        chosen(frames[wanted[0][1]], unused)  # says which axes there are
    jobs = [(kind, frame) for kind, variable in wanted for frame in chosen(frames[variable], own[variable])]
    if len(jobs) > MANY and not request.all:
        raise RequestError(
            f"that is {len(jobs)} files; choose cells with --at, such as --at {_first_axis(frames[wanted[0][1]])}, or "
            f"write them with --all"
        )
    outcome = Exported(_folder(request, jobs))
    ready = []
    for kind, frame in jobs:
        if frame.status in FINISHED:
            ready.append(_Job(frame, kind, _path(request, outcome.folder, kind, frame, len(jobs))))
        else:
            outcome.skipped.append((frame.where() or frame.variable, frame.status.replace("_", " ")))
    if len({job.path for job in ready}) < len(ready):
        raise RequestError("two pictures would have the same file name; export them one by one with --at and --output")
    there = [job.path for job in ready if job.path.exists()]
    if there and not request.force:
        more = f" and {len(there) - 1} more" if len(there) > 1 else ""
        raise RequestError(f"{there[0]}{more} exists; write over it with --force, or elsewhere with --output")
    for job in ready:
        if job.kind == "dng":  # before the first file is written
            _refuse_unsaid(shelf, job.frame)
    for job in ready:
        _write(job.path, _writer(shelf, job))
        outcome.files.append(job.path)
    outcome.notes += dict.fromkeys(
        text for job in ready if job.kind == "dng" and (text := note(mask_of(shelf, job.frame)))
    )
    return outcome


# -- where to ---------------------------------------------------------------------------------------------------


def _has(frames: list[Frame], name: str) -> bool:
    return any(is_called(name, dim, f.group.parameters.get(dim, dim)) for f in frames for dim in f.labels)


def _first_axis(frames: list[Frame]) -> str:
    dim, value = next(iter(frames[0].labels.items()))
    return f"{dim}={plain(value)}"


def _is_file(request: Request, jobs: list[tuple[str, Frame]]) -> bool:
    suffix = request.output.suffix.lower() if request.output else ""
    known = suffix in [one for suffixes in SUFFIXES.values() for one in suffixes]
    if known and request.output is not None and not request.output.is_dir():
        if len(jobs) != 1:
            raise RequestError(
                f"--output {request.output} is one file, but {len(jobs)} would be written; name a folder"
            )
        if suffix not in SUFFIXES[jobs[0][0]]:
            raise RequestError(
                f"--output {request.output}: a {jobs[0][0].upper()} file ends in {' or '.join(SUFFIXES[jobs[0][0]])}"
            )
        return True
    return False


def _folder(request: Request, jobs: list[tuple[str, Frame]]) -> Path:
    if request.output is None:
        return Path(f"{request.archive.resolve().name}-export")
    return request.output.parent if _is_file(request, jobs) else request.output


def _path(request: Request, folder: Path, kind: str, frame: Frame, count: int) -> Path:
    if count == 1 and request.output is not None and folder != request.output:
        return request.output
    parts = [request.archive.resolve().name, *([frame.variable] if frame.variable != "raw" else [])]
    parts += [
        f"{dim}-{re.sub(r'[^A-Za-z0-9.+-]+', '-', plain(value)).strip('-')}" for dim, value in frame.labels.items()
    ]
    return folder / f"{'_'.join(parts)}{SUFFIXES[kind][0]}"


def _write(path: Path, write: Callable[[Path], None]) -> None:
    """Whole or not at all: beside its place first, then renamed."""
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(f".{path.name}.{os.getpid()}.partial")
    try:
        write(partial)
        os.replace(partial, path)
    finally:
        partial.unlink(missing_ok=True)


# -- what stands in it --------------------------------------------------------------------------------------------


def _refuse_unsaid(shelf: Shelf, frame: Frame) -> None:
    """What a DNG needs and the archive does not say."""
    faults = []
    mask = mask_of(shelf, frame)
    why = dng.refusal(mask)
    if why:
        faults.append(Fault("--dng", f"{why}; write the digital numbers with --tiff"))
    elif mask is not None:
        for variable in ("white", "colour_matrix"):
            if shelf.beside(frame, variable, BALANCE) is None:
                stage = next(installed_stages().makers(variable), "")
                faults.append(
                    Fault(
                        "--dng",
                        f"the archive holds no {variable!r}: put the stage {stage!r} into the pipeline and keep it, or "
                        f"use --tiff",
                    )
                )
    for name in ("bits", "black_level"):
        if shelf.parameter(frame, name) is None:
            faults.append(
                Fault("--dng", f"no stage of the archive says {name!r}; write the digital numbers with --tiff")
            )
    if faults:
        raise RequestError(faults)


def raw_frame(shelf: Shelf, frame: Frame) -> dng.RawFrame:
    """Everything a DNG says of a cell."""
    time = shelf.beside(frame, "integration_time")  # found by the camera itself where it meters; 0.008 in any precision
    return dng.RawFrame(
        raw=frame.picture(),
        mask=mask_of(shelf, frame),
        black=float(shelf.parameter(frame, "black_level")),
        white_level=white_level(shelf, frame),
        camera_white=shelf.beside(frame, "white", BALANCE),
        balanced_to_xyz=shelf.beside(frame, "colour_matrix"),
        illuminant=str(shelf.parameter(frame, "illuminant", "")),
        exposure=float(str(time.reshape(())[()]))
        if time is not None and time.size == 1
        else shelf.parameter(frame, "integration_time"),
        f_number=shelf.parameter(frame, "f_number"),
        focal_length=shelf.parameter(frame, "focal_length"),
        iso=_iso(shelf, frame),
        model=str(shelf.record.get("sensor") or shelf.record["pipeline"]).encode("ascii", "replace").decode(),
        serial=str(shelf.parameter(frame, "sensor_serial", "")).encode("ascii", "replace").decode(),
        description=described(shelf, frame),
        software=_software(),
        when=_when(shelf),
    )


def white_level(shelf: Shelf, frame: Frame) -> int:
    """The code at which pixels saturate: the top code, or the full well where that comes first and a stage clips
    there.
    """
    top: int = 2 ** int(shelf.parameter(frame, "bits")) - 1
    if not any(FULL_WELL in shelf.roles(stage) for stage in shelf.record["nodes"]):
        return top
    well, gain, chain = (
        [shelf.parameter(frame, name) for name in names] for names in (WELL, GAIN, ("conversion_gain", "black_level"))
    )
    if None in (*well, *gain, *chain):  # no stage says how charge becomes numbers
        return top
    filled, (conversion, black), bits = amplifier.full_well(*well), chain, int(shelf.parameter(frame, "bits"))
    step = amplifier.dn_per_electron(conversion, amplifier.gain_of_speed(*gain), filled, black, bits)
    return round(float(black) + amplifier.white_level(filled, step, black, bits))


def _iso(shelf: Shelf, frame: Frame) -> float | None:
    """The speed that was set, or that of the gain; None where no stage knows one."""
    speed = shelf.parameter(frame, "iso", 0.0)
    return speed or shelf.parameter(frame, "base_iso", 0.0) * shelf.parameter(frame, "analogue_gain", 1.0) or None


def _writer(shelf: Shelf, job: _Job) -> Callable[[Path], None]:
    if job.kind == "dng":
        return lambda path: dng.write(path, raw_frame(shelf, job.frame))
    if job.kind == "png":
        return lambda path: png.write(
            path, png.array_of(job.frame), shelf.white(job.frame), described(shelf, job.frame)
        )
    encoded = job.frame.variable == "rgb_display" and _is_srgb(shelf, job.frame)
    return lambda path: tiff.write(
        path, job.frame.picture(), described(shelf, job.frame), _software(), _when(shelf), encoded
    )


def _is_srgb(shelf: Shelf, frame: Frame) -> bool:
    shown: dict[str, Any] = {
        k: v for node in shelf.record["nodes"].values() for k, v in node["shown"].items() if k == "display"
    }
    return str(shelf.parameter(frame, "encoding")) == "sRGB" and shown.get("display", "sRGB") == "sRGB"


def _software() -> str:
    return f"etendue {importlib.metadata.version('etendue')}"


def _when(shelf: Shelf) -> str:
    """When the run began, as TIFF writes it: two exports of an archive are the same file. '' where its record says
    no time.
    """
    written = str(shelf.record["began"]).replace("-", ":").replace("T", " ").rstrip("Z")
    return written if re.fullmatch(r"\d{4}(:\d\d){2} \d\d(:\d\d){2}", written, re.ASCII) else ""
