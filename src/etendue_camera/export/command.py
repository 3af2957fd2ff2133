"""Implementation of ``etendue export``: select cells and files, and write each file completely or not at all.

In:  the folder of an archive, the request.
Out: files; the list of files written, and of pictures that could not be written.
"""

from __future__ import annotations

import importlib.metadata
import os
import re
import sys
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import click

from etendue import streams
from etendue.archive import places
from etendue.cli.saying import say
from etendue.contract.registry import installed_stages
from etendue.errors import Fault, RequestError
from etendue.present.plots.places import is_called, read_at
from etendue.types.documents import Document
from etendue_camera.electronics import amplifier
from etendue_camera.export import dng, png, tiff
from etendue_camera.export.frames import FINISHED, ArchivedFrame, Shelf, chosen, described, plain
from etendue_camera.export.masks import mask_of, note
from etendue_camera.roles import BALANCE, FULL_WELL

MANY = 64
WELL = ("pixel_pitch", "aperture_fraction", "full_well_density")
GAIN = ("analogue_gain", "iso", "base_iso")
Picks = list[tuple[str, str]]  # kind of file, variable
SUFFIXES = {"dng": (".dng",), "tiff": (".tif", ".tiff"), "png": (".png",)}


@dataclass(frozen=True)
class ExportRequest:
    """The options of the command line."""

    archive: Path
    dng: bool = False
    tiff: bool = False
    png: bool = False
    variables: tuple[str, ...] = ()  # for TIFF and PNG files; empty: raw, and display values as PNG
    at: tuple[str, ...] = ()
    stage: str = ""
    output: Path | None = None
    everything: bool = False
    force: bool = False


@dataclass
class Exported:
    """The result of an export."""

    folder: Path
    files: list[Path] = field(default_factory=list)
    skipped: list[tuple[str, str]] = field(default_factory=list)  # picture, reason
    notes: list[str] = field(default_factory=list)


def export(asked: ExportRequest) -> Exported:
    """Write every requested picture.

    Raises
    ------
    RequestError
        If nothing is requested, an axis, value, stage or variable does not exist, DNG cannot express the mask, or a
        file exists.
    ArchiveError
        If the folder is not an archive, or damaged.
    """
    wanted = _wanted(asked)
    shelf = Shelf(asked.archive)
    pictures = _chosen(shelf, asked, wanted)
    folder = asked.output or Path(f"{asked.archive.resolve().name}-export")
    outcome = Exported(folder.parent if asked.output is not None and _is_file(asked, pictures) else folder)
    jobs = []
    for kind, frame in pictures:
        if frame.status in FINISHED:
            jobs.append((_path(asked, outcome.folder, kind, frame, len(pictures)), kind, frame))
        else:
            outcome.skipped.append((frame.where() or frame.variable, frame.status.replace("_", " ")))
    _refuse_overwriting([path for path, _, _ in jobs], asked.force)
    raws = [frame for _, kind, frame in jobs if kind == "dng"]
    for frame in raws:  # before the first file is written
        _refuse_unsaid(shelf, frame)
    for path, kind, frame in jobs:
        _write(path, _writer(shelf, kind, frame))
        outcome.files.append(path)
    outcome.notes += dict.fromkeys(text for frame in raws if (text := note(mask_of(shelf, frame))))
    return outcome


# -- selection --------------------------------------------------------------------------------------------------


def _wanted(asked: ExportRequest) -> Picks:
    """Return the kinds of files and their variables."""
    kinds = (
        ("dng", asked.dng, ("raw",)),
        ("tiff", asked.tiff, asked.variables or ("raw",)),
        ("png", asked.png, asked.variables or ("rgb_display",)),
    )
    wanted = [(kind, variable) for kind, on, shown in kinds if on for variable in dict.fromkeys(shown)]
    if not wanted:
        raise RequestError("nothing to write; give --dng, --tiff, --png or several of them")
    if asked.variables and not asked.tiff and not asked.png:
        raise RequestError("--variable is for --tiff and --png; a DNG file always contains raw")
    return wanted


def _chosen(shelf: Shelf, asked: ExportRequest, wanted: Picks) -> list[tuple[str, ArchivedFrame]]:
    """Return the pictures of every kind at the requested axis values."""
    at = read_at(asked.at)
    stages = {variable: asked.stage if len(wanted) == 1 or variable == "raw" else "" for _, variable in wanted}
    light = {variable for kind, variable in wanted if kind == "png"}  # bands of light form one picture only in a PNG
    frames = {
        variable: shelf.frames(variable, stages[variable], variable in light and not asked.tiff)
        for _, variable in wanted
    }
    own = {variable: {k: v for k, v in at.items() if _has(found, k)} for variable, found in frames.items()}
    unused = {k: v for k, v in at.items() if not any(k in taken for taken in own.values())}
    first = frames[wanted[0][1]]
    if unused:
        chosen(first, unused)  # raises, listing the axes
    found = [(kind, frame) for kind, variable in wanted for frame in chosen(frames[variable], own[variable])]
    if len(found) > MANY and not asked.everything:
        dim, value = next(iter(first[0].labels.items()))
        raise RequestError(
            f"{len(found)} files would be written; choose cells with --at, such as --at {dim}={plain(value)}, or "
            f"write them with --all"
        )
    return found


def _has(frames: list[ArchivedFrame], name: str) -> bool:
    return any(
        is_called(name, dim, f.group.parameters.get(dim, dim)) or name == f.group.row_dim(dim)
        for f in frames
        for dim in f.labels
    )


# -- targets ----------------------------------------------------------------------------------------------------


def _refuse_overwriting(paths: list[Path], force: bool) -> None:
    if len(set(paths)) < len(paths):
        raise RequestError("two pictures have the same file name; export them one at a time with --at and --output")
    there = [path for path in paths if path.exists()]
    if there and not force:
        more = f" and {len(there) - 1} more" if len(there) > 1 else ""
        raise RequestError(f"{there[0]}{more} exists; write over it with --force, or elsewhere with --output")


def _is_file(asked: ExportRequest, pictures: list[tuple[str, ArchivedFrame]]) -> bool:
    suffix = asked.output.suffix.lower() if asked.output else ""
    known = suffix in [one for suffixes in SUFFIXES.values() for one in suffixes]
    if known and asked.output is not None and not asked.output.is_dir():
        if len(pictures) != 1:
            raise RequestError(
                f"--output {asked.output} is a single file, but {len(pictures)} would be written; give a folder"
            )
        if suffix not in SUFFIXES[pictures[0][0]]:
            kind = pictures[0][0]
            raise RequestError(
                f"--output {asked.output}: a {kind.upper()} file must end in {' or '.join(SUFFIXES[kind])}"
            )
        return True
    return False


def _path(asked: ExportRequest, folder: Path, kind: str, frame: ArchivedFrame, count: int) -> Path:
    if count == 1 and asked.output is not None and folder != asked.output:
        return asked.output
    parts = [asked.archive.resolve().name, *([frame.variable] if frame.variable != "raw" else [])]
    parts += [
        f"{dim}-{re.sub(r'[^A-Za-z0-9.+-]+', '-', plain(value)).strip('-')}" for dim, value in frame.labels.items()
    ]
    return folder / f"{'_'.join(parts)}{SUFFIXES[kind][0]}"


def _write(path: Path, write: Callable[[Path], None]) -> None:
    """Write completely or not at all: to a temporary file first, then rename it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(f".{path.name}.{os.getpid()}.partial")
    try:
        write(partial)
        os.replace(partial, path)
    finally:
        partial.unlink(missing_ok=True)


# -- file content ------------------------------------------------------------------------------------------------


def _refuse_unsaid(shelf: Shelf, frame: ArchivedFrame) -> None:
    """Raise RequestError if the archive lacks something that a DNG needs."""
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
                        f"the archive has no {variable!r}: add the stage {stage!r} to the pipeline and keep it, or "
                        f"use --tiff",
                    )
                )
    for name in ("bits", "black_level"):
        if shelf.parameter(frame, name) is None:
            faults.append(
                Fault("--dng", f"no stage of the archive gives {name!r}; write the digital numbers with --tiff")
            )
    if faults:
        raise RequestError(faults)


def raw_frame(shelf: Shelf, frame: ArchivedFrame) -> dng.RawFrame:
    """Return the digital numbers of a cell and the metadata that a DNG contains."""
    speed = shelf.parameter(frame, "iso", 0.0)  # the ISO that was set, or else that of the gain
    speed = speed or shelf.parameter(frame, "base_iso", 0.0) * shelf.parameter(frame, "analogue_gain", 1.0)
    time = shelf.beside(frame, "integration_time")  # from metering if any; read as text, so 0.008 stays 0.008
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
        iso=speed or None,
        model=str(shelf.record.get("sensor") or shelf.record["pipeline"]).encode("ascii", "replace").decode(),
        serial=str(shelf.parameter(frame, "sensor_serial", "")).encode("ascii", "replace").decode(),
        description=described(shelf, frame),
        software=_software(),
        when=_when(shelf),
    )


def white_level(shelf: Shelf, frame: ArchivedFrame) -> int:
    """Return the code at which pixels saturate: the code of a full well if a stage clips there and it is below the top
    code, otherwise the top code.
    """
    top: int = 2 ** int(shelf.parameter(frame, "bits")) - 1
    if not any(FULL_WELL in shelf.roles(stage) for stage in shelf.record["nodes"]):
        return top
    well, gain, chain = (
        [shelf.parameter(frame, name) for name in names] for names in (WELL, GAIN, ("conversion_gain", "black_level"))
    )
    if None in (*well, *gain, *chain):  # no stage gives the conversion of charge to codes
        return top
    filled, (conversion, black), bits = amplifier.full_well(*well), chain, int(shelf.parameter(frame, "bits"))
    step = amplifier.dn_per_electron(conversion, amplifier.gain_of_speed(*gain), filled, black, bits)
    return round(float(black) + amplifier.white_level(filled, step, black, bits))


def _writer(shelf: Shelf, kind: str, frame: ArchivedFrame) -> Callable[[Path], None]:
    if kind == "dng":
        return lambda path: dng.write(path, raw_frame(shelf, frame))
    if kind == "png":
        return lambda path: png.write(path, png.array_of(frame), shelf.white(frame), described(shelf, frame))
    encoded = frame.variable == "rgb_display" and _is_srgb(shelf, frame)
    return lambda path: tiff.write(path, frame.picture(), described(shelf, frame), _software(), _when(shelf), encoded)


def _is_srgb(shelf: Shelf, frame: ArchivedFrame) -> bool:
    shown: Document = {
        k: v for node in shelf.record["nodes"].values() for k, v in node["shown"].items() if k == "display"
    }
    return str(shelf.parameter(frame, "encoding")) == "sRGB" and shown.get("display", "sRGB") == "sRGB"


def _software() -> str:
    return f"etendue {importlib.metadata.version('etendue')}"


def _when(shelf: Shelf) -> str:
    """Return the start of the run in TIFF form, so that two exports of an archive are identical; '' if its record has
    no time.
    """
    written = str(shelf.record["began"]).replace("-", ":").replace("T", " ").rstrip("Z")
    return written if re.fullmatch(r"\d{4}(:\d\d){2} \d\d(:\d\d){2}", written, re.ASCII) else ""


def export_command(place: Path | str, as_json: bool, **words: Any) -> None:
    with places.reading(place) as folder:
        done = export(ExportRequest(folder, **words))
    if as_json:
        say(
            {
                "files": [str(path) for path in done.files],
                "skipped": [{"at": where, "why": why} for where, why in done.skipped],
            }
        )
    else:
        with streams.results():
            for path in done.files[:10]:
                click.echo(str(path))
            if len(done.files) > 10:
                click.echo(f"... {len(done.files)} files in {done.folder}")
        for text in done.notes:
            click.echo(f"note: {text}", err=True)
        for where, why in done.skipped:
            click.echo(f"{where}: no picture, the cell is {why}", err=True)
    sys.exit(3 if done.skipped else 0)
