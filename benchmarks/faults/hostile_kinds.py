"""Kinds of malicious files: archives that point outside or never end, files that expand or point to themselves.

In:  an archive (a copy, digests recomputed by ``reseal``) or an empty folder; a folder outside.
Out: the archive is changed in place; for a file, its path.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import shutil
import struct
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

from etendue.archive.journaling.journal import summed

Act = Callable[[Path, Path], object]
LIGHT = "wavelength_nm,power\n300,1\n900,1\n"


def sound_archive(folder: Path) -> Path:
    """Make a small archive with an input: a uniform grey whose light is a table."""
    import etendue
    from etendue import stages as s

    folder.parent.mkdir(parents=True, exist_ok=True)
    table = folder.parent / "light.csv"
    table.write_text(LIGHT)
    scene = s.uniform(name="scene", white_luminance="300 cd m-2", width="48 um", height="48 um", bin_width="100 nm")
    made = etendue.Pipeline(
        scene, s.irradiance(), s.pixel(), s.mosaic(), s.exposure(), s.shot_noise(), s.adc(), name="tiny"
    )
    made = made.camera(
        peak_qe=[0.36, 0.44, 0.40], pixel_pitch="6 um", focal_length="7 mm", illuminant=str(table)
    ).sweep(f_number=[2, 4])
    made.run(folder, progress=False)
    table.unlink()
    return folder


# -- recomputed digests
# ------------------------------------------------------------------------------------------------------


def sha(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest() if path.is_file() else ""


def reseal(archive: Path, also: dict[str, str] | None = None) -> None:
    """Write a manifest for the files as they are now; ``also``: digests by path, wherever they lead."""
    manifest = json.loads((archive / "manifest.json").read_text())
    for part in ("metadata", "files"):
        manifest[part] = {path: sha(archive / path) or known for path, known in manifest[part].items()}
    manifest["files"] |= also or {}
    manifest["journal"] = sha(archive / "journal.jsonl")
    whole = [manifest["metadata"], manifest["files"], manifest["journal"]]
    manifest["sum"] = hashlib.sha256(json.dumps(whole, sort_keys=True).encode()).hexdigest()
    (archive / "manifest.json").write_text(json.dumps(manifest, indent=1))


def pipeline_edited(change: Callable[[str], str]) -> Act:
    """Change the pipeline of the last run in its record, its file and the journal."""

    def act(archive: Path, outside: Path) -> None:
        record = archive / "runs" / "0001.json"
        document = json.loads(record.read_text())
        document["resolved"] = change(document["resolved"].replace("@OUTSIDE@", str(outside))).replace(
            "@OUTSIDE@", str(outside)
        )
        text = json.dumps(document, indent=1)
        record.write_text(text)
        record.with_suffix(".toml").write_text(document["resolved"])
        lines = []
        for line in (archive / "journal.jsonl").read_bytes().splitlines():
            event = json.loads(line)
            if event["event"] == "record":
                event.pop("sum", None)
                event["text"] = text if event["path"].endswith("json") else document["resolved"]
                line = summed(json.dumps(event, separators=(",", ":")).encode())
            lines.append(line)
        (archive / "journal.jsonl").write_bytes(b"\n".join(lines) + b"\n")
        reseal(archive)

    return act


def leads_to(path: str) -> Act:
    return pipeline_edited(lambda text: re.sub(r'"\.\./inputs/[^"]*"', json.dumps(path), text))


def line_added(event: dict[str, object]) -> Act:
    def act(archive: Path, outside: Path) -> None:
        with (archive / "journal.jsonl").open("ab") as file:
            file.write(
                summed(json.dumps(event, separators=(",", ":")).replace("@OUTSIDE@", str(outside)).encode()) + b"\n"
            )
        reseal(archive)

    return act


def named_in_manifest(path: str) -> Act:
    return lambda archive, outside: reseal(
        archive,
        {path.replace("@OUTSIDE@", str(outside)): sha(Path(path.replace("@OUTSIDE@", str(outside)))) or "0" * 64},
    )


# -- files that never end or never answer
# ---------------------------------------------------------------------------------


def replaced(path: str, make: Callable[[Path, Path], object]) -> Act:
    def act(archive: Path, outside: Path) -> None:
        for place in sorted(archive.glob(path))[:1]:
            if place.is_dir():
                shutil.rmtree(place)
            else:
                place.unlink()
            make(place, outside)

    return act


def fifo(place: Path, outside: Path) -> None:
    os.mkfifo(place)


def sparse(place: Path, outside: Path) -> None:
    with place.open("wb") as file:
        file.truncate(200 << 30)


def link(place: Path, outside: Path) -> None:
    place.symlink_to(outside / "secret.txt")


def folder_link(place: Path, outside: Path) -> None:
    place.symlink_to(outside)


def added(path: str, make: Callable[[Path, Path], object]) -> Act:
    return lambda archive, outside: make(archive / path, outside)


def sparse_end(path: str) -> Act:
    def act(archive: Path, outside: Path) -> None:
        for place in sorted(archive.glob(path))[:1]:
            with place.open("r+b") as file:
                file.truncate(200 << 30)

    return act


def metadata_edited(path: str, change: Callable[[dict], object]) -> Act:
    def act(archive: Path, outside: Path) -> None:
        place = archive / path
        document = json.loads(place.read_text())
        change(document)
        place.write_text(json.dumps(document))
        root = archive / "data.zarr" / "zarr.json"
        whole = json.loads(root.read_text())
        name = path.removeprefix("data.zarr/").removesuffix("/zarr.json")
        if name in whole.get("consolidated_metadata", {}).get("metadata", {}):
            whole["consolidated_metadata"]["metadata"][name] = document
            root.write_text(json.dumps(whole))
        reseal(archive)

    return act


def shape_of(size: int) -> Callable[[dict], object]:
    return lambda document: document.update(shape=[size] * len(document["shape"]))


def long_line(archive: Path, outside: Path) -> None:
    manifest = archive / "manifest.json"
    reseal(archive, {f"runs/{'x' * 1_000_000}": "0" * 64})
    assert manifest.stat().st_size > 1_000_000


def through_a_link(archive: Path, outside: Path) -> None:
    (archive / "beside").symlink_to(outside)
    reseal(archive, {"beside/secret.txt": sha(outside / "secret.txt")})


def swept_beyond(text: str, axis: str) -> str:
    """Return a pipeline of 10^12 cells, whose own limit allows them."""
    steps = (
        "f_number = { from = 1, to = 9, steps = 100000 }\nintegration_time = { from = 0.001, to = 0.1, steps = 100000 }"
    )
    return re.sub(axis, steps, "most_cells = 1000000000000000000\n" + text, flags=re.M)


def many_names(archive: Path, outside: Path) -> None:
    reseal(archive, {f"runs/n{number}": "0" * 64 for number in range(20_000)})


SHARD = "data.zarr/adc/raw/c.*"
RAW = "data.zarr/adc/raw/zarr.json"

ARCHIVES: dict[str, Act] = {
    "manifest names a file outside": named_in_manifest("@OUTSIDE@/secret.txt"),
    "manifest names /etc/passwd": named_in_manifest("/etc/passwd"),
    "manifest names /dev/zero": named_in_manifest("/dev/zero"),
    "manifest climbs out": named_in_manifest("data.zarr/../../../outside/secret.txt"),
    "manifest through a linked folder": through_a_link,
    "pipeline names a file outside": leads_to("@OUTSIDE@/secret.txt"),
    "pipeline climbs out of inputs": leads_to("../inputs/../../../outside/secret.txt"),
    "pipeline climbs out of a package": leads_to("package:numpy/../../../../../../../../../../etc/passwd"),
    "pipeline names a file of a package": leads_to("package:etendue_camera/data/silicon_absorption.csv"),
    "pipeline names /dev/zero": leads_to("/dev/zero"),
    "pipeline raises the cell limit": pipeline_edited(lambda text: swept_beyond(text, r"^f_number = .*$")),
    "input is a link": replaced("inputs/*", link),
    "inputs is a link": replaced("inputs", folder_link),
    "runs is a link": replaced("runs", folder_link),
    "a group is a link": replaced("data.zarr/adc", folder_link),
    "the store is a link": replaced("data.zarr", folder_link),
    "fifo for the manifest": replaced("manifest.json", fifo),
    "fifo for the journal": replaced("journal.jsonl", fifo),
    "fifo for a record": replaced("runs/0001.json", fifo),
    "fifo for a pipeline": replaced("runs/0001.toml", fifo),
    "fifo for metadata": replaced("data.zarr/zarr.json", fifo),
    "fifo for an array's metadata": replaced(RAW, fifo),
    "fifo for a shard": replaced(SHARD, fifo),
    "fifo for a coordinate": replaced("data.zarr/*/f_number/c/0", fifo),
    "fifo for an input": replaced("inputs/*", fifo),
    "fifo for measured errors": lambda a, o: (
        (a / "measured.json").unlink(missing_ok=True),
        fifo(a / "measured.json", o),
    ),
    "fifo for the owner": lambda a, o: ((a / "run.id").unlink(missing_ok=True), fifo(a / "run.id", o)),
    "fifo for the lock": lambda a, o: ((a / "lock").unlink(missing_ok=True), fifo(a / "lock", o)),
    "fifo for the crate": replaced("ro-crate-metadata.json", fifo),
    "fifo for the sheet": replaced("contact_sheet.png", fifo),
    "fifo beside the store": added("more", fifo),
    "sparse manifest": replaced("manifest.json", sparse),
    "sparse journal": replaced("journal.jsonl", sparse),
    "sparse record": replaced("runs/0001.json", sparse),
    "sparse root": replaced("data.zarr/zarr.json", sparse),
    "sparse metadata": replaced(RAW, sparse),
    "sparse shard": replaced(SHARD, sparse),
    "lengthened shard": sparse_end(SHARD),
    "lengthened coordinate": sparse_end("data.zarr/*/f_number/c/0"),
    "sparse input": replaced("inputs/*", sparse),
    "sparse measured errors": lambda a, o: sparse(a / "measured.json", o),
    "sparse owner": lambda a, o: sparse(a / "run.id", o),
    "sparse crate": replaced("ro-crate-metadata.json", sparse),
    "sparse sheet": replaced("contact_sheet.png", sparse),
    "sparse file beside": added("more.bin", sparse),
    "sparse file in the store": added("data.zarr/more.bin", sparse),
    "sparse input that nothing uses": added("inputs/more.bin", sparse),
    "sparse record that no run wrote": added("runs/0002.json", sparse),
    "a shape of a billion": metadata_edited(RAW, shape_of(10**9)),
    "a shape of 10**18": metadata_edited(RAW, shape_of(10**18)),
    "a negative shape": metadata_edited(RAW, shape_of(-5)),
    "a shape of texts": metadata_edited(RAW, lambda d: d.update(shape=["many"])),
    "an unknown data type": metadata_edited(RAW, lambda d: d.update(data_type="float9")),
    "an object's data type": metadata_edited(RAW, lambda d: d.update(data_type="object")),
    "a coordinate's shape": metadata_edited("data.zarr/adc/f_number/zarr.json", shape_of(10**12)),
    "an unknown codec": metadata_edited(RAW, lambda d: d.update(codecs=[{"name": "numcodecs.pickle"}])),
    "dims of another length": metadata_edited(RAW, lambda d: d.update(dimension_names=["a"])),
    "a name of a million characters": long_line,
    "20,000 names": many_names,
    "a manifest of a list": lambda a, o: (a / "manifest.json").write_text("[" * 100_000),
    "a record nested 100,000 deep": lambda a, o: ((a / "runs" / "0001.json").write_text('{"a":' * 100_000), reseal(a)),
    "a chunk of 200 GB": line_added(
        {
            "event": "done",
            "cell": "adc f_number=2",
            "key": "0" * 32,
            "status": "done",
            "seconds": 1.0,
            "clipped": 0.0,
            "clipped_flux": 0.0,
            "floored": 0.0,
            "files": [["data.zarr/adc/raw/c.0.0.0", 0, "a", 0, 200 << 30, 1]],
        }
    ),
    "a block of 10**12 slots": line_added(
        {
            "event": "blocks",
            "group": "adc",
            "blocks": {"raw": {"block": [10**12], "form": "uint16 8x8", "codec": [], "chunk": [8, 8]}},
        }
    ),
    "a shard outside": line_added({"event": "shard", "path": "@OUTSIDE@/secret.txt", "size": 40, "kept": []}),
    "thousands of records": lambda a, o: [
        shutil.copy(a / "runs" / "0001.json", a / "runs" / f"{n:04}.json") for n in range(2, 4000)
    ],
}


# -- files that pipelines and commands name
# ---------------------------------------------------------------------------------


def pipeline_with(folder: Path, use: str, file: Path | str, more: str = "") -> Path:
    camera = '[camera]\nf_number = 2.8\nfocal_length = "7 mm"\npixel_pitch = "5 um"\n'
    lit = (
        'white_luminance = "300 cd m-2"\nwidth = "48 um"\nheight = "48 um"\nspacing = "6 um"\n'
        if use == "photograph"
        else ""
    )
    stages = f'[[stages]]\nuse = "{use}"\nfile = "{file}"\n{lit}{more}[[stages]]\nuse = "irradiance"\n'
    (folder / "x.toml").write_text(f'name = "x"\n{camera}{stages}')
    return folder / "x.toml"


def bank(folder: Path, file: str) -> Path:
    """Return a pipeline with a lens whose point spread functions are in a file."""
    text = (Path(__file__).parents[2] / "pipelines" / "smallest.toml").read_text()
    stage = f'[[stages]]\nuse = "lens_psf_field"\nfile = "{file}"\n\n'
    first, then = re.split(r'(?=\[\[stages\]\]\nuse = "pixel")', text, maxsplit=1)
    return toml_of(folder, first + stage + then)


def own_ifd(path: Path) -> Path:
    """Write 26 bytes: a directory of one entry that is followed by itself."""
    path.write_bytes(struct.pack("<2sHI", b"II", 42, 8) + struct.pack("<HHHII", 1, 256, 3, 1, 8) + struct.pack("<I", 8))
    return path


def ring_of_ifds(path: Path) -> Path:
    """Write two directories, each followed by the other."""
    entry = struct.pack("<HHHII", 1, 256, 3, 1, 8)
    path.write_bytes(struct.pack("<2sHI", b"II", 42, 8) + entry + struct.pack("<I", 26) + entry + struct.pack("<I", 8))
    return path


def large_picture(path: Path, side: int = 400_000) -> Path:
    """Write a PNG of a few bytes that claims 1.6e11 pixels."""
    import zlib

    def part(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    path.write_bytes(
        b"\x89PNG\r\n\x1a\n"
        + part(b"IHDR", struct.pack(">IIBBBBB", side, side, 8, 2, 0, 0, 0))
        + part(b"IDAT", zlib.compress(bytes(1 << 20)))
        + part(b"IEND", b"")
    )
    return path


def npz_bomb(path: Path, count: int = 600_000_000) -> Path:
    with (
        zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as file,
        file.open("cube.npy", "w", force_zip64=True) as member,
    ):
        np.lib.format.write_array_header_1_0(member, {"descr": "<f8", "fortran_order": False, "shape": (count,)})
        for _ in range(count // 1_000_000):
            member.write(bytes(8_000_000))
    return path


def npy_of(path: Path, shape: tuple[int, ...]) -> Path:
    with path.open("wb") as file:
        np.lib.format.write_array_header_1_0(file, {"descr": "<f8", "fortran_order": False, "shape": shape})
        file.write(bytes(800))
    return path


def hdf5_external(path: Path, outside: Path) -> Path:
    import h5py

    with h5py.File(path, "w") as file:
        file.create_dataset("cube", (4, 4, 3), "u1", external=[(str(outside / "secret.txt"), 0, 48)])
    return path


def hdf5_virtual(path: Path, outside: Path) -> Path:
    import h5py

    with h5py.File(outside / "other.h5", "w") as file:
        file["data"] = np.ones((4, 4, 3))
    layout = h5py.VirtualLayout((4, 4, 3), "f8")
    layout[:] = h5py.VirtualSource(str(outside / "other.h5"), "data", (4, 4, 3))
    with h5py.File(path, "w") as file:
        file.create_virtual_dataset("cube", layout)
    return path


def hdf5_link(path: Path, outside: Path) -> Path:
    import h5py

    with h5py.File(outside / "other.h5", "w") as file:
        file["data"] = np.ones((4, 4, 3))
    with h5py.File(path, "w") as file:
        file["cube"] = h5py.ExternalLink(str(outside / "other.h5"), "/data")
    return path


def hdf5_sparse(path: Path) -> Path:
    import h5py

    with h5py.File(path, "w") as file:
        file.create_dataset("cube", (100_000, 100_000, 31), "f4", chunks=(100, 100, 31), fillvalue=1.0)
    return path


def envi(folder: Path, outside: Path, data: str) -> Path:
    lines = [
        "ENVI",
        "samples = 4",
        "lines = 4",
        "bands = 3",
        "header offset = 0",
        "data type = 1",
        "interleave = bsq",
        "byte order = 0",
        "wavelength = {450, 550, 650}",
        f"data file = {data}",
    ]
    (folder / "cube.hdr").write_text("\n".join(lines) + "\n")
    return folder / "cube.hdr"


def toml_of(folder: Path, text: str) -> Path:
    (folder / "x.toml").write_text(text)
    return folder / "x.toml"


def sweep_beyond(folder: Path) -> Path:
    """Write a pipeline of 10^12 cells, whose own limit allows them."""
    text = (Path(__file__).parents[2] / "pipelines" / "smallest.toml").read_text()
    return toml_of(
        folder, swept_beyond(re.sub(r"^integration_time = \[.*$", "", text, flags=re.M), r"^f_number = \[.*$")
    )


FILES: dict[str, tuple[Callable[[Path, Path], Path], tuple[str, ...]]] = {
    "a fifo as a photograph": (lambda f, o: (os.mkfifo(f / "p.png"), f / "p.png")[1], ("measure",)),
    "a fifo as a pipeline": (lambda f, o: (os.mkfifo(f / "x.toml"), f / "x.toml")[1], ("plan",)),
    "a pipeline with a fifo": (
        lambda f, o: (os.mkfifo(f / "p.png"), pipeline_with(f, "photograph", "p.png"))[1],
        ("plan",),
    ),
    "a pipeline with /dev/zero": (lambda f, o: pipeline_with(f, "photograph", "/dev/zero"), ("plan",)),
    "a TIFF that points to itself": (lambda f, o: own_ifd(f / "p.tif"), ("measure", "import")),
    "a pipeline with such a TIFF": (lambda f, o: pipeline_with(f, "photograph", own_ifd(f / "p.tif").name), ("plan",)),
    "a TIFF with circular directories": (lambda f, o: ring_of_ifds(f / "p.tif"), ("measure", "import")),
    "a pipeline with such circular directories": (
        lambda f, o: pipeline_with(f, "photograph", ring_of_ifds(f / "p.tif").name),
        ("plan",),
    ),
    "a DNG that points to itself": (lambda f, o: own_ifd(f / "p.dng"), ("measure",)),
    "a PNG of 1.6e11 pixels": (lambda f, o: large_picture(f / "p.png"), ("measure",)),
    "a pipeline with such a PNG": (
        lambda f, o: pipeline_with(f, "photograph", large_picture(f / "p.png").name),
        ("plan",),
    ),
    "a sparse picture": (lambda f, o: (sparse(f / "p.png", o), f / "p.png")[1], ("measure",)),
    "a sparse pipeline": (lambda f, o: (sparse(f / "x.toml", o), f / "x.toml")[1], ("plan",)),
    "a pipeline with a sparse bank": (lambda f, o: (sparse(f / "p.npz", o), bank(f, "p.npz"))[1], ("plan",)),
    "an npz bomb": (lambda f, o: npz_bomb(f / "p.npz"), ("import",)),
    "a pipeline with an npz bomb": (lambda f, o: bank(f, npz_bomb(f / "p.npz").name), ("plan",)),
    "an npy of 10**15 numbers": (lambda f, o: npy_of(f / "p.npy", (10**5, 10**5, 10**5)), ("import",)),
    "HDF5 with external storage": (lambda f, o: hdf5_external(f / "p.h5", o), ("import",)),
    "HDF5 with a virtual dataset": (lambda f, o: hdf5_virtual(f / "p.h5", o), ("import",)),
    "HDF5 with a link to another file": (lambda f, o: hdf5_link(f / "p.h5", o), ("import",)),
    "HDF5 of 1.2 TB of fill values": (lambda f, o: hdf5_sparse(f / "p.h5"), ("import",)),
    "a MATLAB file with external storage": (lambda f, o: hdf5_external(f / "p.mat", o), ("import",)),
    "an ENVI header that names a file outside": (lambda f, o: envi(f, o, str(o / "secret.txt")), ("import",)),
    "an ENVI header that climbs out": (lambda f, o: envi(f, o, "../outside/secret.txt"), ("import",)),
    "most_cells of 10**18": (lambda f, o: sweep_beyond(f), ("plan", "run")),
    "a name of a million characters": (
        lambda f, o: toml_of(f, f'name = "x"\n[camera]\n{"y" * 1_000_000} = 1\n'),
        ("plan",),
    ),
    "a value of a million characters": (
        lambda f, o: toml_of(f, f'name = "x"\n[camera]\nf_number = "{"y" * 1_000_000}"\n'),
        ("plan",),
    ),
    "20,000 unknown names": (
        lambda f, o: toml_of(f, 'name = "x"\n[camera]\n' + "".join(f"y{n} = 1\n" for n in range(20_000))),
        ("plan",),
    ),
    "20,000 unknown stages": (
        lambda f, o: toml_of(f, 'name = "x"\n' + "".join(f'[[stages]]\nuse = "y{n}"\n' for n in range(20_000))),
        ("plan",),
    ),
}
