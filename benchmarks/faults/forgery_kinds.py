"""Consistent forgeries: changed archives with all digests recomputed, so that no file contradicts another.

In:  an archive (a copy).
Out: it is changed in place; ``verify`` finds nothing.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from hostile_kinds import reseal

from etendue.archive.journaling.journal import summed
from etendue.archive.read.earlier_pictures import digest
from etendue.archive.sharding.chunks import decode, encode
from etendue.archive.structure.metadata import text_chunk, texts_of

Forge = Callable[[Path], object]


def sealed(archive: Path) -> None:
    """Recompute the metadata of all nodes in the root, the digest of the pictures, the records in the journal, and the
    manifest.
    """
    store = archive / "data.zarr"
    root = json.loads((store / "zarr.json").read_text())
    frames = store / "frames" / "zarr.json"
    if frames.is_file():
        files = {
            path.relative_to(store).as_posix(): path.read_bytes()
            for path in (store / "frames").rglob("*")
            if path.is_file()
        }
        own = json.loads(frames.read_text())
        own["attributes"]["digest"] = digest(files)
        frames.write_text(json.dumps(own, indent=2))
    held = root["consolidated_metadata"]["metadata"]
    for name in held:
        node = store / name / "zarr.json"
        if node.is_file():
            fresh = json.loads(node.read_text())
            held[name] = {
                **fresh,
                **(
                    {"consolidated_metadata": held[name]["consolidated_metadata"]}
                    if fresh["node_type"] == "group"
                    else {}
                ),
            }
    (store / "zarr.json").write_text(json.dumps(root, indent=2))
    lines = []
    for line in (archive / "journal.jsonl").read_bytes().splitlines():
        event = json.loads(line)
        if event["event"] == "record":
            event["text"] = (archive / event["path"]).read_text()
        event.pop("sum", None)
        lines.append(summed(json.dumps(event, separators=(",", ":")).encode()))
    (archive / "journal.jsonl").write_bytes(b"\n".join(lines) + b"\n")
    reseal(archive)


def document(path: str, change: Callable[[Any], object]) -> Forge:
    """Change a JSON file."""

    def act(archive: Path) -> None:
        place = archive / path
        found = json.loads(place.read_text())
        change(found)
        place.write_text(json.dumps(found, indent=1))
        sealed(archive)

    return act


def node(path: str, change: Callable[[Any], object]) -> Forge:
    return document(f"data.zarr/{path}/zarr.json", change)


def values(path: str, change: Callable[[Any], Any]) -> Forge:
    """Change the numbers or texts of a coordinate, status or column; ``change`` returns others of the same shape."""

    def act(archive: Path) -> None:
        place = archive / "data.zarr" / path
        form = json.loads((place / "zarr.json").read_text())
        shape = tuple(form["shape"])
        chunk = place.joinpath("c", *"0" * len(shape))
        if form["data_type"] == "string":
            chunk.write_bytes(text_chunk(list(change(texts_of(chunk.read_bytes())))))
        else:
            array = np.array(decode(chunk.read_bytes(), form["data_type"], shape))
            chunk.write_bytes(encode(np.asarray(change(array), dtype=form["data_type"]).reshape(shape)))
        sealed(archive)

    return act


def lines(event: str, change: Callable[[dict[str, Any]], object]) -> Forge:
    """Change every line of a kind in the journal."""

    def act(archive: Path) -> None:
        place = archive / "journal.jsonl"
        found = [json.loads(line) for line in place.read_bytes().splitlines()]
        for one in found:
            if one["event"] == event:
                change(one)
        place.write_text("".join(json.dumps(one) + "\n" for one in found))
        sealed(archive)

    return act


def record(change: Callable[[dict[str, Any]], object]) -> Forge:
    return document("runs/0001.json", change)


def toml(change: Callable[[str], str], also: bool = False) -> Forge:
    """Change the pipeline that readers are told to run; with ``also`` that of the record too."""

    def act(archive: Path) -> None:
        place = archive / "runs" / "0001.toml"
        place.write_text(change(place.read_text()))
        if also:
            own = json.loads(place.with_suffix(".json").read_text())
            own["resolved"] = place.read_text()
            place.with_suffix(".json").write_text(json.dumps(own, indent=1))
        sealed(archive)

    return act


def several(*acts: Forge) -> Forge:
    return lambda archive: [act(archive) for act in acts]


def first(value: object) -> Callable[[Any], Any]:
    """Replace the first of some numbers or texts."""

    def change(found: Any) -> Any:
        found[(0,) * np.ndim(found) if isinstance(found, np.ndarray) else 0] = value
        return found

    return change


def attribute(name: str, value: object) -> Callable[[Any], object]:
    return lambda found: found["attributes"].__setitem__(name, value)


def of_cell(text: str, **more: object) -> Callable[[dict[str, Any]], object]:
    return lambda line: line.update(more) if text in line["cell"] else None


def chunk_edited(archive: Path) -> None:
    """Change a number of a stored cell, its checksum in the shard, and its digest in the journal."""
    import google_crc32c

    place = archive / "data.zarr" / "adc" / "raw" / "c.0.0.0"
    found = [json.loads(line) for line in (archive / "journal.jsonl").read_bytes().splitlines()]
    one = next(line for line in found if line["event"] == "done" and line["cell"].startswith("adc "))
    (own,) = one["files"]
    shard = next(line for line in found if line["event"] == "shard" and line["path"] == own[0])
    offset = own[3] - shard["kept"][0][1] + shard["kept"][0][2]
    data = bytearray(place.read_bytes())
    data[offset] ^= 1
    own[5] = int(google_crc32c.value(bytes(data[offset : offset + own[4] - 4])))
    data[offset + own[4] - 4 : offset + own[4]] = own[5].to_bytes(4, "little")
    place.write_bytes(data)
    (archive / "journal.jsonl").write_text("".join(json.dumps(line) + "\n" for line in found))
    sealed(archive)


def renamed_cells(archive: Path) -> None:
    """Change an axis value in coordinates, names of cells, records and pipelines, but not in the keys."""
    for path in [archive / "journal.jsonl", *(archive / "runs").glob("*.json")]:
        text = path.read_text()
        path.write_text(
            re.sub(r"f_number=4\.0", "f_number=4.5", re.sub(r"(\"f_number\": ?\[\s*2\.0,\s*)4\.0", r"\g<1>4.5", text))
        )
    for place in (archive / "data.zarr").glob("*/f_number"):
        values(f"{place.parent.name}/f_number", lambda found: [2.0, 4.5])(archive)
    toml(lambda text: text.replace("f_number = [2, 4]", "f_number = [2, 4.5]"), also=True)(archive)


def added_array(archive: Path) -> None:
    import shutil

    shutil.copytree(archive / "data.zarr" / "adc" / "status", archive / "data.zarr" / "adc" / "trusted")
    _known(archive, "adc/trusted")


def lost_array(path: str) -> Forge:
    def act(archive: Path) -> None:
        import shutil

        shutil.rmtree(archive / "data.zarr" / path)
        manifest = json.loads((archive / "manifest.json").read_text())
        manifest["metadata"] = {
            name: own for name, own in manifest["metadata"].items() if not name.startswith(f"data.zarr/{path}/")
        }
        (archive / "manifest.json").write_text(json.dumps(manifest))
        root = archive / "data.zarr" / "zarr.json"
        whole = json.loads(root.read_text())
        whole["consolidated_metadata"]["metadata"].pop(path)
        root.write_text(json.dumps(whole))
        sealed(archive)

    return act


def _known(archive: Path, array: str) -> None:
    """Name an added array where ours are named."""
    manifest = json.loads((archive / "manifest.json").read_text())
    place = archive / "data.zarr" / array
    own = {path.relative_to(archive).as_posix(): "" for path in place.rglob("*") if path.is_file()}
    manifest["metadata"] |= own
    (archive / "manifest.json").write_text(json.dumps(manifest))
    root = archive / "data.zarr" / "zarr.json"
    whole = json.loads(root.read_text())
    whole["consolidated_metadata"]["metadata"][array] = json.loads((place / "zarr.json").read_text())
    root.write_text(json.dumps(whole))
    sealed(archive)


def big_endian(found: Any) -> None:
    _inner(found)["configuration"]["endian"] = "big"


def _inner(found: Any) -> Any:
    own = found["codecs"]
    shard = next((one for one in own if one["name"] == "sharding_indexed"), None)
    return next(one for one in (shard["configuration"]["codecs"] if shard else own) if one["name"] == "bytes")


def entity(name: str, change: Callable[[dict[str, Any]], object]) -> Forge:
    return document(
        "ro-crate-metadata.json", lambda found: [change(one) for one in found["@graph"] if one["@id"] == name]
    )


def stage_of(name: str, **more: object) -> Callable[[dict[str, Any]], object]:
    return lambda found: found["nodes"][name].update(more)


RAW, RATE = "adc/raw", "pixel/photon_rate"

FORGERIES: dict[str, Forge] = {
    # not detected by earlier versions
    "a coordinate reversed": values("adc/f_number", lambda found: found[::-1]),
    "positions times ten": values("pixel/x_um", lambda found: found * 10),
    "wavelengths plus 100": several(
        values("irradiance/wavelength", lambda found: found + 100),
        values("irradiance/wavelength_bounds", lambda found: found + 100),
    ),
    "dims swapped": node(RAW, lambda found: found["dimension_names"].__setitem__(slice(1, 3), ["x", "y"])),
    "a unit": node("exposure/expected_charge", attribute("units", "ke")),
    "a data type": node(RAW, lambda found: found.update(data_type="int16")),
    "a byte order": node(RATE, big_endian),
    "a status": values("adc/status", first(2)),
    "an error in the ledger": values("ledger/error", lambda found: found / 100),
    "a parameter in the record": record(lambda found: found["shared"].update(pixel_pitch=5.0)),
    "another seed in the pipeline to be run": toml(lambda text: text.replace("seed = 0", "seed = 1")),
    "another f-number in the pipeline to be run": toml(
        lambda text: text.replace("f_number = [2, 4]", "f_number = [2.8, 4]")
    ),
    "an extra stage in the pipeline to be run": toml(lambda text: text + '\n[[stages]]\nuse = "white"\nname = "w"\n'),
    "a comment in the pipeline to be run": toml(lambda text: f"# published with the paper\n{text}"),
    # arrays
    "a long name": node(RATE, attribute("long_name", "photons on the sensor")),
    "an extra attribute": node(RATE, attribute("calibrated", "yes")),
    "a missing attribute": node("exposure/expected_charge", lambda found: found["attributes"].pop("units")),
    "named coordinates": node(RATE, attribute("coordinates", "y_um")),
    "a unit of a coordinate": node("pixel/x_um", attribute("units", "mm")),
    "a fill value": node(RATE, lambda found: found.update(fill_value=0.0)),
    "dims renamed": node(
        RATE, lambda found: found.update(dimension_names=["pixel_pitch", *found["dimension_names"][1:]])
    ),
    "channels swapped": values("pixel/channel", lambda found: [*found[1:], found[0]]),
    "one position": values("adc/y", first(7)),
    "one edge of a bin": values("scene/wavelength_bounds", first(1.0)),
    "the meaning of a status": node(
        "adc/status", attribute("flag_meanings", "not_computed left_out failed skipped done")
    ),
    "the stage of a group": node("adc", attribute("stage", "adc_ideal")),
    "the order of stages": node("adc", attribute("order", 1)),
    "the format of the archive": document(
        "data.zarr/zarr.json", lambda found: found["attributes"]["etendue"].update(format=1)
    ),
    "the axes of a stage": document(
        "data.zarr/zarr.json", lambda found: found["attributes"]["etendue"]["axes"].update(adc=[])
    ),
    "an extra array": added_array,
    "a missing coordinate": lost_array("adc/x_um"),
    "a codec": node(RATE, lambda found: found["codecs"][0]["configuration"].update(index_location="start")),
    "a shape": node("adc/y", lambda found: found.update(shape=[4])),
    # tables
    "a status in the ledger": values("ledger/status", first("left_out")),
    "the basis of an error": values("ledger/how", first("proved")),
    "a bound": values("ledger/bound", first(1e-9)),
    "a clipped fraction": values("ledger/clipped", first(0.5)),
    "a key in the ledger": values("ledger/key", first("0" * 32)),
    "an axis value in the ledger": values("ledger/at_f_number", lambda found: found + 1),
    "a message": values("ledger/message", first("verified by a laboratory")),
    "a stage in the ledger": values("ledger/use", first("uniform_calibrated")),
    "seconds in the ledger": values("ledger/seconds", lambda found: found / 10),
    "a title": node("ledger", attribute("title", "measured errors")),
    "cells in the summary": values("summary/cells", lambda found: found + 1),
    "the worst error": values("summary/worst_error", lambda found: found * 0),
    "bytes in the summary": values("summary/bytes", lambda found: found + 8),
    # pictures
    "a picture": values("frames/preview", lambda found: 255 - found),
    "the position of a picture": node("frames", attribute("at", " at f_number 22")),
    "the true size of a picture": values("frames/true_width", lambda found: found * 2),
    # the journal
    "a key in the journal": lines("done", of_cell("adc ", key="0" * 32)),
    "a status in the journal": lines("done", of_cell("adc f_number=2", status="left_out")),
    "a clipped fraction in the journal": lines("done", of_cell("adc f_number=2", clipped=0.5)),
    "a count of floored values": lines("done", of_cell("adc f_number=2", floored=3.0)),
    "a number of a cell": chunk_edited,
    "an axis value throughout": renamed_cells,
    "an axis value that no run requested": lines(
        "axes", lambda one: one["axes"].update(f_number=[2.0, 4.0, 9.0]) if one["axes"] else None
    ),
    # records
    "a digest of code": record(stage_of("adc", code=["0" * 32])),
    "a source": record(lambda found: found["sources"].update({next(iter(found["sources"])): "0" * 32})),
    "a missing source": record(lambda found: found["sources"].pop(next(iter(found["sources"])))),
    "a parameter of a stage": record(lambda found: found["nodes"]["adc"]["shown"].update(bits=16)),
    "the inputs of a stage": record(stage_of("adc", inputs=["scene"])),
    "a seed in the record": record(stage_of("shot_noise", seed=7)),
    "a stage in the record": record(stage_of("adc", role=["scene"])),
    "axes in the record": record(lambda found: found["axes"].update(f_number=[2.0, 4.0, 5.6])),
    "the order in the record": record(lambda found: found["order"].reverse()),
    "the text of the original file": record(lambda found: found.update(text=found["text"].replace("300 cd", "900 cd"))),
    "overrides": record(lambda found: found.update(overrides={"camera.focal_length": '"9 mm"'})),
    "a tolerance": record(lambda found: found["options"].update(tolerance=1e-9)),
    "an extra field": record(lambda found: found.update(certified="yes")),
    "the name of the sensor": record(lambda found: found.update(sensor="sony-imx174")),
    "a precision": record(stage_of("adc", precision="float64")),
    "a seed in record and pipeline": toml(lambda text: text.replace("seed = 0", "seed = 1"), also=True),
    # read by other programs
    "the input of a run": entity("#run-0001", lambda one: one.update(object={"@id": "inputs/other"})),
    "a tool": entity("#stage-adc", lambda one: one.update(identifier="blake2b:0")),
    "the digest of an input": document(
        "ro-crate-metadata.json",
        lambda found: [one.update(sha256="0" * 64) for one in found["@graph"] if "sha256" in one],
    ),
}

# what cannot be recomputed: its entry in the list of what is not checked
SAID: dict[str, tuple[Forge, str]] = {
    "when a run began": (
        several(
            record(lambda found: found.update(began="1999-01-01T00:00:00Z")),
            entity("#run-0001", lambda one: one.update(startTime="1999-01-01T00:00:00+00:00")),
            entity("./", lambda one: one.update(datePublished="1999-01-01")),
        ),
        "dates",
    ),
    "seconds, consistently": (
        several(
            lines("done", lambda line: line.update(seconds=1.0)),
            values("ledger/seconds", lambda found: found * 0 + 1),
            values("summary/seconds", lambda found: found * 0 + 1),
        ),
        "seconds",
    ),
    "the platform": (
        record(lambda found: found["platform"].update(machine="sparc")),
        "recorded versions, platform and code",
    ),
    "a version": (
        record(lambda found: found["distributions"].update(etendue="9.9")),
        "recorded versions, platform and code",
    ),
    "an author": (
        entity("./", lambda one: one.update(author={"@id": "#a"})),
        "names, texts, licence and authors",
    ),
    "the name of the archive": (
        document("data.zarr/zarr.json", lambda found: found["attributes"]["etendue"].update(pipeline="x")),
        "names, texts, licence and authors",
    ),
    "a drawing": (
        lambda archive: ((archive / "contact_sheet.png").write_bytes(b"\x89PNG"), sealed(archive)),
        "contact_sheet.png",
    ),
    "how a run was done": (record(lambda found: found["options"].update(scheduler="dask")), "how a run was done"),
    "a foreign file": (lambda archive: (archive / "README").write_text("calibrated"), "foreign files"),
}
