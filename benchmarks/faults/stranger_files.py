"""More malicious files, of every format that pipelines and commands name: false sizes, expanding parts, code in data.

In:  an empty folder, a folder outside.
Out: the path of the file; by kind, with the commands to try on it (``FILES``).
"""

from __future__ import annotations

import json
import os
import pickle
import struct
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
from hostile_kinds import bank, pipeline_with, toml_of

Make = Callable[[Path, Path], Path]
OWNED = "owned.txt"  # in the folder outside: the file that a pickle would write
SMALLEST = (Path(__file__).parents[2] / "pipelines" / "smallest.toml").read_text()


def png_part(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def png(path: Path, side: int = 8, *more: bytes, depth: int = 8, data: bytes | None = None) -> Path:
    body = zlib.compress(bytes(side * (3 * side * depth // 8 + 1))) if data is None else data
    head = png_part(b"IHDR", struct.pack(">IIBBBBB", side, side, depth, 2, 0, 0, 0))
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + head + b"".join(more) + png_part(b"IDAT", body) + png_part(b"IEND", b""))
    return path


def unfolding_text() -> bytes:
    return zlib.compress(bytes(1_500_000_000), 1)


def jpeg(path: Path, exif: bytes = b"", size: tuple[int, int] = (8, 8), more: bytes = b"") -> Path:
    from PIL import Image

    Image.new("RGB", (8, 8), (90, 120, 60)).save(path, "JPEG")
    data = path.read_bytes()
    parts = b"\xff\xe1" + struct.pack(">H", len(exif) + 8) + b"Exif\0\0" + exif if exif else b""
    at = data.index(b"\xff\xc0") + 5
    data = data[:at] + struct.pack(">HH", *size) + data[at + 4 :]
    path.write_bytes(data[:2] + parts + more + data[2:])
    return path


def exif_loop() -> bytes:
    """Return EXIF directories that name themselves as camera directory, GPS directory and next directory."""
    entries = (
        struct.pack("<HHII", 0x8769, 4, 1, 8)
        + struct.pack("<HHII", 0x8825, 4, 1, 8)
        + struct.pack("<HHII", 0xA005, 4, 1, 8)
    )
    return struct.pack("<2sHI", b"II", 42, 8) + struct.pack("<H", 3) + entries + struct.pack("<I", 8)


def tiff(path: Path, tags: list[tuple[int, int, int, int]], more: bytes = b"") -> Path:
    """Write tags (number, type, count, value) in one directory."""
    body = b"".join(struct.pack("<HHII", *tag) for tag in sorted(tags))
    path.write_bytes(struct.pack("<2sHIH", b"II", 42, 8, len(tags)) + body + struct.pack("<I", 0) + more)
    return path


def usual(side: int, offset: int = 200, count: int = 64) -> list[tuple[int, int, int, int]]:
    return [(256, 4, 1, side), (257, 4, 1, side), (258, 3, 1, 8), (259, 3, 1, 1), (262, 3, 1, 1), (273, 4, 1, offset),
            (277, 3, 1, 1), (278, 4, 1, side), (279, 4, 1, count)]  # fmt: skip


def big_tiff(path: Path) -> Path:
    path.write_bytes(struct.pack("<2sHHHQQ", b"II", 43, 8, 0, 16, 2**60) + bytes(200))
    return path


def deflated_tiff(path: Path) -> Path:
    """Write a strip that expands to 1.5 GB, for a picture of 8 x 8."""
    data = unfolding_text()
    tags = [one for one in usual(8, 200, len(data)) if one[0] != 259]
    return tiff(path, [*tags, (259, 3, 1, 8)], bytes(200 - 10 - 12 * 9 - 4) + data)


class Owns:
    """A pickle that writes a file when it is loaded."""

    def __init__(self, outside: Path) -> None:
        self.outside = outside

    def __reduce__(self) -> tuple[object, ...]:
        return (exec, (f"open({str(self.outside / OWNED)!r}, 'w').write('x')",))


def pickled(folder: Path, outside: Path) -> bytes:
    header = b"{'descr': '|O', 'fortran_order': False, 'shape': (1, 1, 1), }"
    header += b" " * (64 - (len(header) + 11) % 64) + b"\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header + pickle.dumps(Owns(outside))


def npy_header(text: str, version: bytes = b"\x01\x00") -> bytes:
    return b"\x93NUMPY" + version + struct.pack("<H" if version[0] == 1 else "<I", len(text)) + text.encode()


def written(path: Path, data: bytes | str) -> Path:
    path.write_bytes(data.encode() if isinstance(data, str) else data)
    return path


def npz_of(path: Path, parts: dict[str, bytes]) -> Path:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as file:
        for name, data in parts.items():
            file.writestr(name, data)
    return path


def npz_of_many(path: Path) -> Path:
    """Write thirty arrays of 160 MB, each below the size that is refused."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as file:
        for number in range(30):
            with file.open(f"a{number}.npy", "w") as member:
                np.lib.format.write_array_header_1_0(
                    member, {"descr": "<f8", "fortran_order": False, "shape": (20_000_000,)}
                )
                for _ in range(20):
                    member.write(bytes(8_000_000))
    return path


def npz_that_lies(path: Path) -> Path:
    """Write an entry that claims 800 bytes in the directory and expands to far more."""
    npz_of(
        path,
        {
            "cube.npy": npy_header("{'descr': '<f8', 'fortran_order': False, 'shape': (100000000, 1, 1), }\n")
            + bytes(400_000_000)
        },
    )
    data = path.read_bytes()
    path.write_bytes(data.replace(struct.pack("<I", 400_000_000 + 80), struct.pack("<I", 800)))
    return path


def hdf5(path: Path, make: Callable[[object], object]) -> Path:
    import h5py

    with h5py.File(path, "w") as file:
        make(file)
    return path


def many_fills(file: object) -> None:
    for number in range(40):
        file.create_dataset(f"a{number}", (4, 1000, 7_000), "f8", chunks=(1, 100, 100), fillvalue=1.0)


def loops(file: object) -> None:
    import h5py

    file["a"] = h5py.SoftLink("/b")
    file["b"] = h5py.SoftLink("/a")
    group = file.create_group("g")
    group["self"] = group
    group["up"] = file["/"]


def deep_groups(file: object) -> None:
    here = file
    for _ in range(3000):
        here = here.create_group("g")


def mat5(path: Path, dims: tuple[int, int, int], deflated: bool = False) -> Path:
    """Write a MATLAB 5 array that states its size."""
    name = b"cube\0\0\0\0"
    flags = struct.pack("<IIII", 6, 8, 6, 0)
    shape = struct.pack("<II", 5, 12) + struct.pack("<iii", *dims) + bytes(4)
    data = struct.pack("<II", 9, 800) + bytes(800)
    body = flags + shape + struct.pack("<II", 1, 4) + name + data
    element = struct.pack("<II", 14, len(body)) + body
    if deflated:
        element = zlib.compress(struct.pack("<II", 14, 1_500_000_000) + body + bytes(1_400_000_000), 1)
        element = struct.pack("<II", 15, len(element)) + element
    path.write_bytes(b"MATLAB 5.0".ljust(124) + b"\x00\x01IM" + element)
    return path


def envi(folder: Path, **more: str) -> Path:
    words = {
        "samples": "4",
        "lines": "4",
        "bands": "3",
        "header offset": "0",
        "data type": "1",
        "interleave": "bsq",
        "byte order": "0",
        "wavelength": "{450, 550, 650}",
        **{key.replace("_", " "): value for key, value in more.items()},
    }
    (folder / "cube.hdr").write_text("ENVI\n" + "".join(f"{key} = {value}\n" for key, value in words.items()))
    if not os.path.lexists(folder / "cube.img"):
        (folder / "cube.img").write_bytes(bytes(48))
    return folder / "cube.hdr"


def envi_linked(folder: Path, outside: Path) -> Path:
    (folder / "cube.img").symlink_to(outside / "secret.txt")
    return envi(folder)


def exr(path: Path, window: tuple[int, int, int, int], channels: int = 3) -> Path:
    def attribute(name: bytes, kind: bytes, data: bytes) -> bytes:
        return name + b"\0" + kind + b"\0" + struct.pack("<I", len(data)) + data

    listed = b"".join(b"w%dnm\0" % (400 + n) + struct.pack("<iiii", 2, 0, 1, 1) for n in range(channels)) + b"\0"
    box = struct.pack("<iiii", *window)
    head = [
        attribute(b"channels", b"chlist", listed),
        attribute(b"compression", b"compression", b"\x03"),
        attribute(b"dataWindow", b"box2i", box),
        attribute(b"displayWindow", b"box2i", box),
        attribute(b"lineOrder", b"lineOrder", b"\0"),
        attribute(b"pixelAspectRatio", b"float", struct.pack("<f", 1)),
        attribute(b"screenWindowCenter", b"v2f", bytes(8)),
        attribute(b"screenWindowWidth", b"float", struct.pack("<f", 1)),
    ]
    path.write_bytes(struct.pack("<II", 20000630, 2) + b"".join(head) + b"\0" + bytes(1000))
    return path


def zarr_cube(folder: Path, **more: object) -> Path:
    """Write a store for the stage radiance_cube with arbitrary metadata."""
    store = folder / "cube.zarr"
    (store / "radiance" / "c" / "0" / "0").mkdir(parents=True)
    (store / "zarr.json").write_text('{"zarr_format": 3, "node_type": "group", "attributes": {}}')
    array = {
        "shape": [3, 4, 4],
        "data_type": "float64",
        "chunk_grid": {"name": "regular", "configuration": {"chunk_shape": [3, 4, 4]}},
        "chunk_key_encoding": {"name": "default", "configuration": {"separator": "/"}},
        "fill_value": 0.0,
        "codecs": [{"name": "bytes", "configuration": {"endian": "little"}}],
        "attributes": {"units": "W m-2 sr-1 nm-1"},
        "dimension_names": ["wavelength", "y", "x"],
        "zarr_format": 3,
        "node_type": "array",
        "storage_transformers": [],
        **more,
    }
    (store / "radiance" / "zarr.json").write_text(json.dumps(array))
    (store / "radiance" / "c" / "0" / "0" / "0").write_bytes(np.ones((3, 4, 4)).tobytes())
    for name, values in {
        "wavelength": [450.0, 550.0, 650.0],
        "y": [0.0, 1.0, 2.0, 3.0],
        "x": [0.0, 1.0, 2.0, 3.0],
    }.items():
        (store / name / "c").mkdir(parents=True)
        (store / name / "c" / "0").write_bytes(np.array(values).tobytes())
        grid = {"name": "regular", "configuration": {"chunk_shape": [len(values)]}}
        codecs = [{"name": "bytes", "configuration": {"endian": "little"}}]
        own = {
            **array,
            "shape": [len(values)],
            "chunk_grid": grid,
            "dimension_names": [name],
            "attributes": {},
            "codecs": codecs,
        }
        (store / name / "zarr.json").write_text(json.dumps(own))
    return pipeline_with(folder, "radiance_cube", "cube.zarr", 'white_luminance = "100 cd m-2"\nspacing = "1 um"\n')


def chunked(*shape: int) -> dict[str, object]:
    return {"name": "regular", "configuration": {"chunk_shape": list(shape)}}


SHARDED = {
    "name": "sharding_indexed",
    "configuration": {"chunk_shape": [1, 1, 1], "codecs": [{"name": "bytes"}], "index_codecs": [{"name": "gzip"}]},
}


def links_in_a_ring(folder: Path, outside: Path) -> Path:
    (folder / "a.png").symlink_to("b.png")
    (folder / "b.png").symlink_to("a.png")
    return pipeline_with(folder, "photograph", "a.png")


def zarr_bomb(folder: Path, outside: Path) -> Path:
    import gzip

    codecs = [{"name": "bytes", "configuration": {"endian": "little"}}, {"name": "gzip", "configuration": {"level": 1}}]
    pipeline = zarr_cube(folder, codecs=codecs)
    (folder / "cube.zarr" / "radiance" / "c" / "0" / "0" / "0").write_bytes(gzip.compress(bytes(1_500_000_000), 1))
    return pipeline


def zarr_fifo(folder: Path, outside: Path) -> Path:
    pipeline = zarr_cube(folder)
    chunk = folder / "cube.zarr" / "radiance" / "c" / "0" / "0" / "0"
    chunk.unlink()
    os.mkfifo(chunk)
    return pipeline


def camera(**more: str) -> Make:
    """Return the smallest pipeline with another value of the camera."""

    def make(folder: Path, outside: Path) -> Path:
        text = SMALLEST
        for key, value in more.items():
            text = text.replace("[camera]\n", f"[camera]\n{key} = {value}\n", 1)
        return toml_of(folder, text)

    return make


def swept(value: str) -> Make:
    import re

    return lambda folder, outside: toml_of(
        folder, re.sub(r"^f_number = \[.*$", lambda found: f"f_number = {value}", SMALLEST, flags=re.M)
    )


def light(text: bytes | str) -> Make:
    """Return a pipeline whose illuminant is a table."""

    def make(folder: Path, outside: Path) -> Path:
        written(folder / "light.csv", text)
        return pipeline_with(folder, "uniform", "", "").parent and _lit(folder)

    return make


def _lit(folder: Path) -> Path:
    camera = '[camera]\nf_number = 2.8\nfocal_length = "7 mm"\npixel_pitch = "5 um"\nilluminant = "light.csv"\n'
    scene = (
        '[[stages]]\nuse = "uniform"\nwhite_luminance = "300 cd m-2"\nwidth = "48 um"\nheight = "48 um"\nbin_width '
        '= "100 nm"\n'
    )
    return toml_of(folder, f'name = "x"\n{camera}{scene}[[stages]]\nuse = "irradiance"\n')


def both(make: Callable[[Path], Path], name: str) -> Make:
    """Return a pipeline with a picture that is also measured."""
    return lambda folder, outside: pipeline_with(folder, "photograph", make(folder / name).name)


PICTURES: dict[str, tuple[str, Callable[[Path], Path]]] = {
    "a PNG of 60,000 x 60,000": ("p.png", lambda p: png(p, 60_000, data=zlib.compress(bytes(1 << 20)))),
    "a PNG whose text expands": ("p.png", lambda p: png(p, 8, png_part(b"zTXt", b"x\0\0" + unfolding_text()))),
    "a PNG whose colours expand": ("p.png", lambda p: png(p, 8, png_part(b"iCCP", b"x\0\0" + unfolding_text()))),
    "a PNG whose picture expands": ("p.png", lambda p: png(p, 8, data=unfolding_text())),
    "a deep PNG whose picture expands": ("p.png", lambda p: png(p, 8, depth=16, data=unfolding_text())),
    "a PNG of 300,000 parts": ("p.png", lambda p: png(p, 8, png_part(b"tEXt", b"x\0y") * 300_000)),
    "a PNG with EXIF in a loop": ("p.png", lambda p: png(p, 8, png_part(b"eXIf", exif_loop()))),
    "a PNG of 3,000 pictures": ("p.png", lambda p: png(p, 8, png_part(b"acTL", struct.pack(">II", 2**31 - 1, 0)))),
    "a PNG part of 2**31 bytes": ("p.png", lambda p: png(p, 8, struct.pack(">I", 2**31 - 1) + b"tEXt")),
    "a JPEG of 65,500 x 65,500": ("p.jpg", lambda p: jpeg(p, size=(65_500, 65_500))),
    "a JPEG of 7,000 x 7,000, empty": ("p.jpg", lambda p: jpeg(p, size=(7_000, 7_000))),
    "a JPEG with EXIF in a loop": ("p.jpg", lambda p: jpeg(p, exif_loop())),
    "a JPEG with 60,000 tags": (
        "p.jpg",
        lambda p: jpeg(p, struct.pack("<2sHIH", b"II", 42, 8, 65_535) + bytes(60_000)),
    ),
    "a JPEG of 20,000 parts": (
        "p.jpg",
        lambda p: jpeg(p, more=(b"\xff\xe2" + struct.pack(">H", 20) + b"ICC_PROFILE\0\x01\xff" + bytes(4)) * 20_000),
    ),
    "a TIFF of 2**31 rows per strip": ("p.tif", lambda p: tiff(p, usual(2**31 - 1))),
    "a TIFF of 2**32 offsets": (
        "p.tif",
        lambda p: tiff(p, [*[t for t in usual(8) if t[0] != 273], (273, 4, 2**32 - 1, 8)]),
    ),
    "a TIFF of 65,535 tags": (
        "p.tif",
        lambda p: written(
            p, struct.pack("<2sHIH", b"II", 42, 8, 65_535) + struct.pack("<HHII", 256, 4, 2**31, 8) * 65_535
        ),
    ),
    "a BigTIFF of 2**60 tags": ("p.tif", big_tiff),
    "a TIFF whose strip expands": ("p.tif", deflated_tiff),
    "a TIFF with directories inside itself": (
        "p.tif",
        lambda p: tiff(p, [*usual(8), (330, 4, 1, 8), (34665, 4, 1, 8)], bytes(300)),
    ),
}

FILES: dict[str, tuple[Make, tuple[str, ...]]] = {
    **{name: (lambda f, o, n=n, make=make: make(f / n), ("measure", "import")) for name, (n, make) in PICTURES.items()},
    **{f"a pipeline with {name}": (both(make, n), ("plan",)) for name, (n, make) in PICTURES.items()},
    "an npy with a pickle": (lambda f, o: written(f / "p.npy", pickled(f, o)), ("import",)),
    "an npz with a pickle": (lambda f, o: npz_of(f / "p.npz", {"cube.npy": pickled(f, o)}), ("import",)),
    "a pickle with another name": (lambda f, o: written(f / "p.npy", pickle.dumps(Owns(o))), ("import",)),
    "an npy with a header of code": (
        lambda f, o: written(
            f / "p.npy", npy_header(f"{{'descr': '<f8', 'shape': (open({str(o / OWNED)!r},'w'),)}}\n")
        ),
        ("import",),
    ),
    "an npy with a header of 100 MB": (
        lambda f, o: written(f / "p.npy", npy_header("(" * 100_000_000, b"\x02\x00")),
        ("import",),
    ),
    "an npy with a nested header": (lambda f, o: written(f / "p.npy", npy_header("(" * 9_000)), ("import",)),
    "an npz that climbs out": (
        lambda f, o: npz_of(f / "p.npz", {"../../outside/owned.txt": b"x", "/etc/owned.npy": b"x"}),
        ("import",),
    ),
    "an npz of thirty bombs": (lambda f, o: npz_of_many(f / "p.npz"), ("import",)),
    "an npz that misstates its size": (lambda f, o: npz_that_lies(f / "p.npz"), ("import",)),
    "an npz of 60,000 arrays": (
        lambda f, o: npz_of(f / "p.npz", {f"a{n}.npy": b"" for n in range(60_000)}),
        ("import",),
    ),
    "a blur with a pickle": (
        lambda f, o: (npz_of(f / "p.npz", {"psf.npy": pickled(f, o), "heights.npy": pickled(f, o)}), bank(f, "p.npz"))[
            1
        ],
        ("plan",),
    ),
    "a blur with bombs": (lambda f, o: (npz_of_many(f / "p.npz"), bank(f, "p.npz"))[1], ("plan",)),
    "HDF5 of forty arrays of fill values": (lambda f, o: hdf5(f / "p.h5", many_fills), ("import",)),
    "HDF5 with circular links": (lambda f, o: hdf5(f / "p.h5", loops), ("import",)),
    "HDF5 of groups 3,000 deep": (lambda f, o: hdf5(f / "p.h5", deep_groups), ("import",)),
    "MATLAB of 2**93 numbers": (lambda f, o: mat5(f / "p.mat", (2**31 - 1,) * 3), ("import",)),
    "MATLAB that expands": (lambda f, o: mat5(f / "p.mat", (14_000, 100, 1000), deflated=True), ("import",)),
    "ENVI of 10**36 numbers": (
        lambda f, o: envi(f, samples="1000000000000", lines="1000000000000", bands="1000000000000"),
        ("import",),
    ),
    "ENVI of 5,000 digits": (lambda f, o: envi(f, samples="9" * 5000), ("import",)),
    "ENVI of an odd type": (lambda f, o: envi(f, data_type="99", interleave="x", byte_order="7"), ("import",)),
    "ENVI through a link": (envi_linked, ("import",)),
    "ENVI of a fifo": (lambda f, o: (os.mkfifo(f / "cube.img"), envi(f))[1], ("import",)),
    "ENVI of /dev/zero": (lambda f, o: ((f / "cube.img").symlink_to("/dev/zero"), envi(f))[1], ("import",)),
    "ENVI, header of 100 MB": (lambda f, o: envi(f, description="{" + "x" * 100_000_000 + "}"), ("import",)),
    "ENVI, unclosed braces": (lambda f, o: envi(f, description="{" * 100_000), ("import",)),
    "ENVI, 3,000,000 wavelengths": (lambda f, o: envi(f, wavelength="{" + "1," * 3_000_000 + "2}"), ("import",)),
    "EXR of 2**62 pixels": (lambda f, o: exr(f / "p.exr", (-(2**30), -(2**30), 2**30, 2**30)), ("import",)),
    "EXR of 20,000 layers": (lambda f, o: exr(f / "p.exr", (0, 0, 63, 63), 20_000), ("import",)),
    "Zarr of 10**30 numbers": (lambda f, o: zarr_cube(f, shape=[10**10] * 3), ("plan",)),
    "Zarr, a chunk of 10**12": (
        lambda f, o: zarr_cube(f, shape=[3, 10**6, 10**6], chunk_grid=chunked(3, 10**6, 10**6)),
        ("plan", "run"),
    ),
    "Zarr that expands": (zarr_bomb, ("plan", "run")),
    "Zarr with a fifo": (zarr_fifo, ("plan", "run")),
    "Zarr with a pickle codec": (lambda f, o: zarr_cube(f, codecs=[{"name": "numcodecs.pickle"}]), ("plan",)),
    "Zarr of 1-number chunks": (
        lambda f, o: zarr_cube(f, shape=[300, 1000, 1000], chunk_grid=chunked(1, 1, 1)),
        ("plan", "run"),
    ),
    "Zarr of shards in shards": (lambda f, o: zarr_cube(f, codecs=[SHARDED]), ("plan", "run")),
    "a table of 10,000,000 lines": (light("wavelength_nm,power\n" + "1,1\n" * 10_000_000), ("plan",)),
    "a table of one line, 50 MB": (light("wavelength_nm,power\n300," + "1" * 50_000_000), ("plan",)),
    "a table of 200,000 columns": (
        light(",".join(f"c{n}" for n in range(200_000)) + "\n" + ",".join("1" * 200_000)),
        ("plan",),
    ),
    "a table of NaN": (light("wavelength_nm,power\n300,nan\nnan,1\n900,inf\n"), ("plan",)),
    "a table of zeros": (light(b"\0" * 100_000), ("plan",)),
    "a table of escapes": (light("\x1b[2J\x1b]0;owned\x07,power\n300,1\n900,1\n"), ("plan",)),
    "a table with unterminated quotes": (light('wavelength_nm,power\n"300,1\n' + "900,1\n" * 200_000), ("plan",)),
    "TOML nested 100,000 deep": (lambda f, o: toml_of(f, "x = " + "[" * 100_000), ("plan",)),
    "TOML of inline tables": (lambda f, o: toml_of(f, "x = " + "{a=" * 100_000), ("plan",)),
    "TOML, thousands of tables": (
        lambda f, o: toml_of(f, "".join(f"[a{n}.b{n}]\n" for n in range(60_000))),
        ("plan",),
    ),
    "TOML, a table of 10,000 parts": (lambda f, o: toml_of(f, "[" + ".".join("a" * 10_000) + "]\n"), ("plan",)),
    "TOML, a quoted key of many parts": (
        lambda f, o: toml_of(f, ".".join('"a b"' for _ in range(20_000)) + " = 1\n"),
        ("plan",),
    ),
    "TOML, a number of 5,000 digits": (camera(f_number="9" * 5000), ("plan",)),
    "TOML, a number of 5,000 hex digits": (camera(f_number="0x" + "f" * 900_000), ("plan",)),
    "TOML, a pitch of 1e-30": (
        lambda f, o: toml_of(f, SMALLEST.replace("pixel_pitch =", 'pixel_pitch = "1e-25 um" #', 1)),
        ("plan",),
    ),
    "TOML, a unit of 100,000 powers": (camera(focal_length='"1 ' + "m^2 " * 100_000 + '"'), ("plan",)),
    "TOML, an unterminated quote": (lambda f, o: toml_of(f, 'name = """' + '\\"""' * 200_000), ("plan",)),
    "TOML, escapes": (
        lambda f, o: toml_of(f, 'name = "\\u001b[2J"\n[camera]\n"\\u001b]0;owned\\u0007" = 1\n'),
        ("plan",),
    ),
    "TOML, an axis of 480,000 times 2": (swept("[" + "2," * 480_000 + "]"), ("plan",)),
    "TOML, an axis of 140,000 numbers": (swept("[" + ",".join(map(str, range(1, 140_001))) + "]"), ("plan",)),
    "a file on the network": (lambda f, o: pipeline_with(f, "photograph", "//192.0.2.1/share/p.png"), ("plan",)),
    "a URL as a file": (lambda f, o: pipeline_with(f, "photograph", "http://192.0.2.1/p.png"), ("plan",)),
    "the URL of a store as a file": (
        lambda f, o: pipeline_with(f, "radiance_cube", "s3://192.0.2.1/p.zarr"),
        ("plan",),
    ),
    "/proc/self/mem as a file": (lambda f, o: pipeline_with(f, "photograph", "/proc/self/mem"), ("plan",)),
    "circular links": (links_in_a_ring, ("plan",)),
}
