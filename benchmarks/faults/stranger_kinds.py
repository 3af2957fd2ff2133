"""More malicious archives: huge numbers and texts, expanding chunks, terminal escapes in names, conflicting metadata.

In:  an archive (a copy) or an empty folder; a folder outside, as for ``hostile_kinds``.
Out: the archive is changed in place, its digests recomputed; for a file, its path.
"""

from __future__ import annotations

import json
import os
import shutil
import struct
from collections.abc import Callable
from copy import deepcopy
from pathlib import Path

import google_crc32c
import numpy as np
from hostile_kinds import RAW, Act, added, line_added, metadata_edited, pipeline_edited, replaced, reseal
from numcodecs import Zstd

from etendue.archive.journaling.journal import summed

JOURNAL = "journal.jsonl"
HUGE = "1" + "0" * 5000  # more digits than Python's int() takes


def crc(body: bytes) -> bytes:
    return body + int(google_crc32c.value(body)).to_bytes(4, "little")


# -- JSON
# ---------------------------------------------------------------------------------------------------------------------


def text_edited(path: str, change: Callable[[str], str]) -> Act:
    def act(archive: Path, outside: Path) -> None:
        for place in sorted(archive.glob(path))[:1]:
            place.write_text(change(place.read_text()))
        reseal(archive)

    return act


def raw_line(*lines: str, times: int = 1) -> Act:
    """Append lines to the journal, with valid checksums."""

    def act(archive: Path, outside: Path) -> None:
        with (archive / JOURNAL).open("ab") as file:
            for line in lines:
                file.write((summed(line.encode()) + b"\n") * times)
        reseal(archive)

    return act


def plain_lines(line: bytes, times: int) -> Act:
    def act(archive: Path, outside: Path) -> None:
        with (archive / JOURNAL).open("ab") as file:
            file.write(line * times)
        reseal(archive)

    return act


def manifest_text(change: Callable[[str], str]) -> Act:
    return lambda archive, outside: (archive / "manifest.json").write_text(
        change((archive / "manifest.json").read_text())
    )


def before_the_end(more: str) -> Callable[[str], str]:
    """Add a member to a JSON document."""
    return lambda text: f"{text.rstrip()[:-1]},{more}}}"


DEEP = '"deep":' + '{"a":' * 100_000 + "1" + "}" * 100_000


# -- chunks
# -------------------------------------------------------------------------------------------------------------------


def chunk_of(name: str, body: Callable[[bytes], bytes]) -> Act:
    """Change the only chunk of an array of tables or coordinates, with a valid checksum."""

    def act(archive: Path, outside: Path) -> None:
        array = next(iter(sorted((archive / "data.zarr").glob(name))))
        chunk = next(path for path in sorted(array.rglob("*")) if path.is_file() and path.name != "zarr.json")
        chunk.write_bytes(crc(body(chunk.read_bytes()[:-4])))
        reseal(archive)

    return act


def blosc_claims(size: int) -> Callable[[bytes], bytes]:
    return lambda body: body[:4] + struct.pack("<i", size) + body[8:]


def blosc_bomb(body: bytes) -> bytes:
    from numcodecs import blosc

    return bytes(blosc.compress(bytes(1_500_000_000), b"lz4", 5, 0))


def zstd_bomb(body: bytes) -> bytes:
    return bytes(Zstd(level=1).encode(bytes(1_500_000_000)))


def texts_claimed(body: bytes) -> bytes:
    return bytes(Zstd().encode(struct.pack("<I", 2**31 - 1)))


def one_long_text(body: bytes) -> bytes:
    count = struct.unpack("<I", bytes(Zstd().decode(body))[:4])[0]
    long = b"x" * 50_000_000
    return bytes(
        Zstd().encode(
            struct.pack("<I", count) + (struct.pack("<I", len(long)) + long) + struct.pack("<I", 0) * (count - 1)
        )
    )


def in_a_shard(change: Callable[[bytes], bytes]) -> Act:
    """Change a chunk of a cell, its checksums in shard and journal; it is put after all others, as the index says."""

    def act(archive: Path, outside: Path) -> None:
        journal = archive / JOURNAL
        found = [json.loads(line) for line in journal.read_bytes().splitlines()]
        done = next(one for one in found if one["event"] == "done" and one["cell"].startswith("adc "))
        own = done["files"][0]
        shard = next(one for one in found if one["event"] == "shard" and one["path"] == own[0])
        place = archive / own[0]
        data, slots = place.read_bytes(), len(list((archive / "data.zarr/adc/f_number").glob("c"))) and 0
        kept = next(one for one in shard["kept"] if one[0] == own[2] and one[1] <= own[3] < one[1] + one[3])
        at = own[3] - kept[1] + kept[2]
        fresh = crc(change(data[at : at + own[4] - 4]))
        cut = sum(one[3] for one in shard["kept"])
        index = np.frombuffer(data[cut:-4], "<u8").reshape(-1, 2).copy()
        row = int(np.flatnonzero((index[:, 0] == at) & (index[:, 1] == own[4]))[0])
        index[row] = cut, len(fresh)
        place.write_bytes(data[:cut] + fresh + crc(index.tobytes()))
        part, offset = f"{own[2]}", max(one[1] + one[3] for one in shard["kept"] if one[0] == own[2]) + slots
        shard["kept"].append([part, offset, cut, len(fresh)])
        shard["size"] = place.stat().st_size
        own[3:6] = offset, len(fresh), int.from_bytes(fresh[-4:], "little")
        lines = [{k: v for k, v in one.items() if k != "sum"} for one in found]
        journal.write_bytes(b"".join(summed(json.dumps(one, separators=(",", ":")).encode()) + b"\n" for one in lines))
        reseal(archive)

    return act


def index_of(change: Callable[[np.ndarray], object]) -> Act:
    """Change the index of a shard, with a valid checksum."""

    def act(archive: Path, outside: Path) -> None:
        place = sorted(archive.glob("data.zarr/adc/raw/c.*"))[0]
        data = place.read_bytes()
        slots = int(
            np.prod(json.loads((archive / RAW).read_text())["chunk_grid"]["configuration"]["chunk_shape"])
        ) // int(np.prod(json.loads((archive / RAW).read_text())["codecs"][0]["configuration"]["chunk_shape"]))
        index = np.frombuffer(data[-16 * slots - 4 : -4], "<u8").reshape(-1, 2).copy()
        change(index)
        place.write_bytes(data[: -16 * slots - 4] + crc(index.tobytes()))
        reseal(archive)

    return act


# -- names and folders
# ----------------------------------------------------------------------------------------------------------


def named(*names: bytes | str) -> Act:
    def act(archive: Path, outside: Path) -> None:
        for name in names:
            place = os.path.join(os.fsencode(archive), os.fsencode(name))
            os.makedirs(os.path.dirname(place), exist_ok=True)
            with open(place, "wb") as file:
                file.write(b"x")

    return act


def many_files(archive: Path, outside: Path) -> None:
    (archive / "data.zarr" / "adc" / "raw" / "more").mkdir()
    for number in range(20_000):
        (archive / "data.zarr" / "adc" / "raw" / "more" / f"c.{number}").touch()


def deep_folders(archive: Path, outside: Path) -> None:
    here = os.open(archive / "data.zarr", os.O_RDONLY)
    for _ in range(1500):
        os.mkdir("deep", dir_fd=here)
        below = os.open("deep", os.O_RDONLY, dir_fd=here)
        os.close(here)
        here = below
    os.close(here)


def links_in_a_ring(archive: Path, outside: Path) -> None:
    (archive / "data.zarr" / "ring").symlink_to("other")
    (archive / "data.zarr" / "other").symlink_to("ring")
    (archive / "runs" / "up").symlink_to("..")


def hard_link(path: str) -> Act:
    """Give a file outside a second name in the archive: writing to the archive must not write to it."""

    def act(archive: Path, outside: Path) -> None:
        place = sorted(archive.glob(path))[0]
        twin = outside / f"twin-{place.name}"
        shutil.copy(place, twin)
        place.unlink()
        os.link(twin, place)

    return act


def folder_for(path: str) -> Act:
    return replaced(path, lambda place, outside: (place.mkdir(), (place / "x").write_text("x")))


def with_url(archive: Path, outside: Path) -> None:
    crate = archive / "ro-crate-metadata.json"
    document = json.loads(crate.read_text())
    document["@context"] = ["http://192.0.2.1/context", {"@import": "http://192.0.2.1/more"}]
    for one in document["@graph"]:
        one["url"] = one["contentUrl"] = "http://192.0.2.1/x"
    crate.write_text(json.dumps(document))
    reseal(archive)


def bomb_for_the_sheet(archive: Path, outside: Path) -> None:
    from hostile_kinds import large_picture

    large_picture(archive / "contact_sheet.png", 60_000)
    reseal(archive)


def record_edited(change: Callable[[dict], object]) -> Act:
    """Change the record of the last run, in the journal too."""

    def act(archive: Path, outside: Path) -> None:
        place = archive / "runs" / "0001.json"
        document = json.loads(place.read_text())
        change(document)
        place.write_text(json.dumps(document))
        lines = []
        for line in (archive / JOURNAL).read_bytes().splitlines():
            event = json.loads(line)
            if event["event"] == "record" and event["path"].endswith("json"):
                event.pop("sum", None)
                event["text"] = place.read_text()
                line = summed(json.dumps(event, separators=(",", ":")).encode())
            lines.append(line)
        (archive / JOURNAL).write_bytes(b"\n".join(lines) + b"\n")
        reseal(archive)

    return act


def root_edited(change: Callable[[dict], object]) -> Act:
    return metadata_edited("data.zarr/zarr.json", change)


def members(document: dict) -> dict:
    return document["consolidated_metadata"]["metadata"]


def codec_of(name: str, **configuration: object) -> Callable[[dict], object]:
    return lambda d: d.update(
        codecs=[
            {"name": "bytes", "configuration": {"endian": "little"}},
            {"name": name, "configuration": configuration},
        ]
    )


def gzip_bomb(archive: Path, outside: Path) -> None:
    import gzip

    for array in sorted((archive / "data.zarr").glob("*/f_number")):
        (array / "c" / "0").write_bytes(gzip.compress(bytes(1_500_000_000), 1))
        metadata_edited(f"{array.relative_to(archive)}/zarr.json", codec_of("gzip", level=1))(archive, outside)


def done(**more: object) -> dict:
    base = {
        "event": "done",
        "cell": "adc f_number=2.0",
        "key": "0" * 32,
        "status": "done",
        "seconds": 1.0,
        "clipped": 0.0,
        "clipped_flux": 0.0,
        "floored": 0.0,
        "files": [],
    }
    return {**base, **more}


COORDINATE, TEXTS, NUMBERS = "data.zarr/adc/f_number/zarr.json", "ledger/stage", "ledger/seconds"
PNG = b"\x89PNG\r\n\x1a\n"

STRANGERS: dict[str, Act] = {
    "JSON: 5,000 digits in the journal": raw_line(json.dumps(done()).replace("1.0", HUGE, 1)),
    "JSON: 5,000 digits in a shape": text_edited(RAW, lambda text: text.replace('"shape": [', f'"shape": [{HUGE},', 1)),
    "JSON: 5,000 digits in the record": text_edited("runs/0001.json", before_the_end(f'"x":{HUGE}')),
    "JSON: 400 digits for seconds": raw_line(json.dumps(done()).replace("1.0", "1" * 400, 1)),
    "JSON: 1e400 for seconds": raw_line(json.dumps(done()).replace("1.0", "1e400", 1)),
    "JSON: NaN for seconds": raw_line(json.dumps(done()).replace("1.0", "NaN", 1)),
    "JSON: a duplicate key in the manifest": manifest_text(before_the_end('"files":{}')),
    "JSON: a lone surrogate": text_edited("runs/0001.json", before_the_end('"name":"\\ud800"')),
    "JSON: a lone surrogate in an attribute": metadata_edited(
        RAW, lambda d: d["attributes"].update(long_name="\ud800", units="\udfff")
    ),
    "JSON: a lone surrogate in the root": root_edited(lambda d: d["attributes"].update(title="\ud800")),
    "JSON: zeros in a name": line_added(
        {"event": "shard", "path": "data.zarr/adc/raw/c\0.0", "size": 40, "kept": [["a\0", 0, 0, 4]]}
    ),
    "JSON: not UTF-8": lambda a, o: ((a / "runs/0001.json").write_bytes(b'{"name": "\xff\xfe"}'), reseal(a)),
    "JSON: deep nesting in the root": text_edited("data.zarr/zarr.json", before_the_end(DEEP)),
    "JSON: deep nesting in an array": text_edited(RAW, before_the_end(DEEP)),
    "JSON: deep nesting in the crate": text_edited("ro-crate-metadata.json", before_the_end(DEEP)),
    "JSON: deep nesting in the journal": raw_line("{" + DEEP + "}"),
    "JSON: deep nesting in measured errors": lambda a, o: (a / "measured.json").write_text("[" * 100_000),
    "JSON: measured errors of other types": lambda a, o: (a / "measured.json").write_text('{"cells": [1], "adc": 7}'),
    "JSON: attributes of 100 MB": root_edited(lambda d: d["attributes"].update(x="y" * 100_000_000)),
    "journal: 1,000,000 empty lines": plain_lines(b"\n", 1_000_000),
    "journal: 1,000,000 lines of {}": plain_lines(b"{}\n", 1_000_000),
    "journal: 300,000 numbers": plain_lines(b"1\n", 300_000),
    "journal: 200,000 lines of a cell": raw_line(json.dumps(done(), separators=(",", ":")), times=200_000),
    "journal: axes of other types": raw_line(
        '{"event":"axes","group":"adc","axes":{"x":[{}]}}', '{"event":"axes","group":7,"axes":[]}'
    ),
    "journal: axes without finite values": raw_line(
        '{"event":"axes","group":"adc","axes":{"f_number":[{"float":"nan"},{"float":"inf"}]}}'
    ),
    "journal: axes of 10**400": raw_line('{"event":"axes","group":"adc","axes":{"f_number":[' + "9" * 400 + "]}}"),
    "journal: an axis of texts": line_added({"event": "axes", "group": "adc", "axes": {"f_number": ["2", "\x1b[2J"]}}),
    "journal: thousands of groups": lambda a, o: plain_lines(
        b"".join(summed(b'{"event":"axes","group":"g%d","axes":{"x":[1]}}' % n) + b"\n" for n in range(20_000)), 1
    )(a, o),
    "journal: a form of other types": line_added(
        {
            "event": "blocks",
            "group": "adc",
            "blocks": {"raw": {"block": [1], "form": "object -3xx9", "codec": "zip", "pieces": 1}},
        }
    ),
    "journal: negative offsets": line_added(done(files=[["data.zarr/adc/raw/c.0.0.0", -1, "a", -5, -7, -9]])),
    "journal: a slot of 2**62": line_added(done(files=[["data.zarr/adc/raw/c.0.0.0", 2**62, "a", 0, 100, 1]])),
    "journal: a shard without numbers": line_added(done(files=[["data.zarr/adc/raw/c.x.-1", 0, "a", 0, 100, 1]])),
    "journal: chunks of a table": line_added(done(files=[["manifest.json", 0, "a", 0, 100, 1], ["", 0, "", 0, 0, 0]])),
    "journal: a run of 10**300 cells": raw_line(
        '{"event":"run","planned":{"adc":1' + "0" * 300 + '},"todo":{"nobody":5}}'
    ),
    "journal: 100,000 outdated": line_added(
        {"event": "outdated", "cells": [f"adc f_number={n}" for n in range(100_000)]}
    ),
    "journal: a record elsewhere": line_added({"event": "record", "path": "runs/../manifest.json", "text": "{}"}),
    "journal: a cell with an odd name": line_added(done(cell="\x1b]0;owned\x07 = == f_number=2=3 f_number")),
    "chunk: a coordinate claims 2 GB": chunk_of("adc/f_number", blosc_claims(2**31 - 1)),
    "chunk: a coordinate claims -1": chunk_of("adc/f_number", blosc_claims(-1)),
    "chunk: a coordinate expands": chunk_of("adc/f_number", blosc_bomb),
    "chunk: a column expands": chunk_of(NUMBERS, blosc_bomb),
    "chunk: texts expand": chunk_of(TEXTS, zstd_bomb),
    "chunk: 2**31 texts": chunk_of(TEXTS, texts_claimed),
    "chunk: a text of 50 MB": chunk_of(TEXTS, one_long_text),
    "chunk: a picture expands": chunk_of("frames/*preview*", blosc_bomb),
    "chunk: a status expands": chunk_of("adc/status", blosc_bomb),
    "chunk: empty": chunk_of("adc/f_number", lambda body: b""),
    "chunk: a cell claims 2 GB": in_a_shard(blosc_claims(2**31 - 1)),
    "chunk: a cell claims 1": in_a_shard(blosc_claims(1)),
    "chunk: a cell expands": in_a_shard(blosc_bomb),
    "chunk: a cell is noise": in_a_shard(lambda body: bytes(range(256)) * 2),
    "index: offsets beyond the file": index_of(lambda index: index.__setitem__((0, 0), 2**63)),
    "index: lengths beyond the file": index_of(lambda index: index.__setitem__((0, 1), 2**64 - 2)),
    "index: all at one offset": index_of(lambda index: index.__setitem__(slice(None), index[0].copy())),
    "codec: gzip": metadata_edited(COORDINATE, codec_of("gzip", level=1)),
    "codec: from numcodecs": metadata_edited(COORDINATE, codec_of("numcodecs.zlib", level=1)),
    "codec: shards in shards": metadata_edited(
        RAW, lambda d: d["codecs"][0]["configuration"].update(codecs=deepcopy(d["codecs"]))
    ),
    "codec: gzip that expands": gzip_bomb,
    "zarr: a transformer": metadata_edited(
        RAW, lambda d: d.update(storage_transformers=[{"name": "x", "configuration": {"url": "http://192.0.2.1"}}])
    ),
    "zarr: version 2": metadata_edited(RAW, lambda d: d.update(zarr_format=2)),
    "zarr: an array in place of a group": metadata_edited(
        "data.zarr/adc/zarr.json", lambda d: d.update(node_type="array")
    ),
    "zarr: chunks without values": metadata_edited(
        RAW, lambda d: d["chunk_grid"]["configuration"].update(chunk_shape=[0] * len(d["shape"]))
    ),
    "zarr: a text as fill value": metadata_edited(RAW, lambda d: d.update(fill_value="many")),
    "zarr: duplicate dims": metadata_edited(RAW, lambda d: d.update(dimension_names=["x"] * len(d["shape"]))),
    "zarr: attributes as a list": metadata_edited(RAW, lambda d: d.update(attributes=[1])),
    "zarr: impossible times": metadata_edited(
        COORDINATE, lambda d: d["attributes"].update(units="days since 0000-99-99", calendar="x")
    ),
    "zarr: a text as scale factor": metadata_edited(
        RAW, lambda d: d["attributes"].update(scale_factor="x", add_offset=[1])
    ),
    "zarr: the root disagrees": root_edited(lambda d: members(d)["adc/raw"].update(shape=[10**12] * 3)),
    "zarr: the root names a place outside": root_edited(
        lambda d: members(d).update({"../../outside": members(d)["adc/raw"], "/etc": {}})
    ),
    "zarr: 20,000 nodes in the root": root_edited(
        lambda d: members(d).update({f"adc/n{n}": members(d)["adc/raw"] for n in range(20_000)})
    ),
    "zarr: nodes of other types": root_edited(lambda d: members(d).update({"adc": 7, "": None})),
    "zarr: axes of other types": root_edited(
        lambda d: d["attributes"].update(etendue={"format": [], "axes": {"adc": 7, "": [{}]}})
    ),
    "record: nodes as a list": record_edited(lambda d: d.update(nodes=[1, 2])),
    "record: every field a number": record_edited(
        lambda d: d.update({key: 7 for key in d if key not in ("resolved", "format")})
    ),
    "record: fields of nodes": record_edited(
        lambda d: [one.update(dict.fromkeys(one, 3)) for one in d["nodes"].values()]
    ),
    "record: escapes": record_edited(lambda d: d.update(pipeline="\x1b[2J\x1b]0;owned\x07", began="\x1b[31m")),
    "record: a name of 5 MB": record_edited(lambda d: d.update(pipeline="n" * 5_000_000)),
    "pipeline: TOML nested 50,000 deep": pipeline_edited(lambda text: f"x = {'[' * 50_000}{']' * 50_000}\n{text}"),
    "pipeline: 20,000 dots": pipeline_edited(lambda text: f"{'.'.join('a' * 20_000)} = 1\n{text}"),
    "pipeline: 3,000,000 axis values": pipeline_edited(
        lambda text: text.replace("[2, 4]", "[" + "2," * 3_000_000 + "]")
    ),
    "pipeline: steps of 10**9": pipeline_edited(
        lambda text: text.replace("[2, 4]", "{ from = 1, to = 9, steps = 1000000000 }")
    ),
    "pipeline: a camera of 200,000 pixels": pipeline_edited(lambda text: text.replace('"48 um"', '"1000 mm"')),
    "pipeline: not a number": pipeline_edited(lambda text: text.replace("[2, 4]", "[nan, inf]")),
    "pipeline: 5,000 digits": pipeline_edited(lambda text: text.replace("[2, 4]", f"[2, {HUGE}]")),
    "pipeline: seed of 400 digits": pipeline_edited(lambda text: text.replace("seed = 0", f"seed = {'9' * 400}")),
    "pipeline: a Windows share": pipeline_edited(
        lambda text: text.replace('"../inputs/', '"//192.0.2.1/share/../inputs/')
    ),
    "pipeline: a URL": pipeline_edited(lambda text: text.replace('"../inputs/', '"http://192.0.2.1/')),
    "names: escapes": named(
        "\x1b[2J\x1b]0;owned\x07", "data.zarr/adc/\x1b[31mraw", "inputs/\x1b[2J", "runs/\r\n# sound"
    ),
    "names: not UTF-8": named(b"\xff\xfe", b"data.zarr/adc/\xff.bin", b"inputs/\xff", b"runs/\xff.json"),
    "names: right to left": named("gnp.\u202e0001", "runs/0001\u202e.json", "inputs/\u202e\u200b"),
    "names: different case": named("JOURNAL.jsonl", "Manifest.json", "RUNS/0001.json", "data.zarr/ADC/raw/c.0"),
    "names: numbers of 4,000 digits": named(
        "runs/" + "9" * 240 + ".json", "runs/-1.json", "runs/\u0661\u0662.json", "runs/0001.JSON"
    ),
    "names: 20,000 files": many_files,
    "names: folders 1,500 deep": deep_folders,
    "names: circular links": links_in_a_ring,
    "names: a hard link to the journal": hard_link(JOURNAL),
    "names: a hard link to an input": hard_link("inputs/*"),
    "a folder in place of the journal": folder_for(JOURNAL),
    "a folder in place of the lock": lambda a, o: ((a / "lock").unlink(missing_ok=True), (a / "lock").mkdir()),
    "a folder in place of an input": folder_for("inputs/*"),
    "a folder in place of a record": folder_for("runs/0001.json"),
    "a deeply nested input folder": added(
        "inputs/" + "0" * 64, lambda p, o: [(p / "/".join("ab" * 100)).mkdir(parents=True)]
    ),
    "URLs in the crate": with_url,
    "a sheet of 3.6e9 pixels": bomb_for_the_sheet,
    "URLs in the owner": lambda a, o: (a / "run.id").write_text("http://192.0.2.1/" * 100_000),
}
