"""What is small in its file and says, or is made, to be large: refused before memory for it is asked for.

The kinds are those of ``benchmarks/faults/stranger_kinds.py`` and ``stranger_files.py``, which also count memory and
time.
"""

import gzip
import io
import os
import shutil
import sys
import zlib
from pathlib import Path

import numpy as np
import pytest
from numcodecs import Blosc, Zstd

from etendue import plain_files
from etendue.archive.sharding import unfolding
from etendue.archive.sharding.chunks import decode, encode
from etendue.archive.structure.metadata import text_chunk, texts_of
from etendue.errors import ArchiveError
from etendue_camera.picture_files import read_picture
from tests.archive.test_hostile import called, outside, sound  # noqa: F401

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks" / "faults"))
import stranger_files as files
import stranger_kinds as kinds

sys.path.pop(0)


def said(data):
    return plain_files.unfolds_to(bytes(data[:18]), bytes(data[-8:]), len(data))


@pytest.mark.parametrize("size", [40, 255, 256, 257, 65_535, 65_536, 65_791, 65_792, 1_000_000])
def test_what_a_chunk_says_of_its_size_is_its_size(size):
    data = np.random.default_rng(size).integers(0, 4, size, np.uint8).tobytes()
    for made in (bytes(Zstd(level=1).encode(data)), bytes(Blosc("lz4").encode(data)), gzip.compress(data, 1)):
        assert said(made) == said(made + b"abcd") == size  # a checksum may stand behind it
    assert said(b"nothing of all this stands here") == 0


def test_a_chunk_unfolds_to_its_numbers_or_is_refused():
    data = encode(np.zeros(10_000))
    assert decode(data, "f8", (10_000,)).size == 10_000
    for size in (2**31 - 1, 79_992, 0, 2**32 - 1):
        forged = kinds.crc(data[:4] + size.to_bytes(4, "little") + data[8:-4])
        with pytest.raises(ArchiveError, match="claim to decompress"):
            decode(forged, "f8", (10_000,))
    with pytest.raises(ArchiveError):
        decode(kinds.crc(data[:-40]), "f8", (10_000,))  # shorter than its header says


def test_texts_are_no_more_than_their_bytes(monkeypatch):
    assert texts_of(text_chunk(["a", "", "b" * 1000])) == ["a", "", "b" * 1000]
    with pytest.raises(ArchiveError, match="more strings than"):
        texts_of(kinds.crc(kinds.texts_claimed(b"")))
    monkeypatch.setattr(unfolding, "MOST", 1 << 20)
    with pytest.raises(ArchiveError, match="decompress"):
        texts_of(kinds.crc(bytes(Zstd().encode(bytes(3 << 20)))))


FOUND = {  # what showed something, by the command that did
    "JSON: 400 digits for seconds": "verify",
    "chunk: a coordinate claims -1": "reproduce",
    "codec: gzip": "export",
    "record: a name of 5 MB": "show",
    "pipeline: 3,000,000 axis values": "reproduce",
    "journal: axes of 10**400": "verify",
    "names: escapes": "verify",
    "record: escapes": "export",
    "JSON: deep nesting in the root": "show",
}


@pytest.mark.timeout(120)
@pytest.mark.parametrize("kind", FOUND)
def test_what_a_stranger_writes_is_refused_in_few_words(kind, sound, outside, tmp_path, monkeypatch):  # noqa: F811
    monkeypatch.chdir(tmp_path)
    folder = shutil.copytree(sound, tmp_path / "tiny")
    kinds.STRANGERS[kind](folder, outside)
    done = called([FOUND[kind], folder, *(["--tiff", "--variable", "raw"] if FOUND[kind] == "export" else [])], outside)
    assert len(done.output) < 20_000 and not set("\x1b\x07\u202e") & set(done.output)


@pytest.mark.parametrize(
    "kind", ["a JPEG of 7,000 x 7,000, empty", "a JPEG with EXIF in a loop", "a TIFF of 2**32 offsets"]
)
def test_a_picture_that_its_file_cannot_hold_is_refused_or_read(kind, outside, tmp_path):  # noqa: F811
    name, make = files.PICTURES[kind]
    assert called(["measure", make(tmp_path / name)], outside).exit_code in (1, 2)


def test_a_picture_of_many_other_parts_is_refused(tmp_path):
    path = files.png(tmp_path / "p.png", 8, files.png_part(b"tEXt", b"x\0y") * 3000)
    with pytest.raises(ValueError, match="chunks besides its image data"):
        read_picture(str(path))
    files.png(path, 8, files.png_part(b"tEXt", b"x\0y") * 100)
    assert read_picture(str(path)).values.shape == (8, 8, 3)


def test_a_strip_that_unfolds_is_refused_and_a_whole_one_is_not(tmp_path):
    import tifffile

    path = tmp_path / "p.tif"
    data = zlib.compress(bytes(20_000_000), 1)
    tags = [one for one in files.usual(8, 200, len(data)) if one[0] != 259]
    files.tiff(path, [*tags, (259, 3, 1, 8)], bytes(200 - 10 - 12 * 9 - 4) + data)
    with pytest.raises(ValueError, match="this is not a valid picture"):
        read_picture(str(path))
    picture = np.random.default_rng(1).integers(0, 255, (300, 200, 3), np.uint8)
    tifffile.imwrite(path, picture, photometric="rgb", compression="zlib")
    np.testing.assert_array_equal(read_picture(str(path)).values, picture)


def test_arrays_are_counted_together(tmp_path, monkeypatch, outside):  # noqa: F811
    monkeypatch.setattr(plain_files, "UNFOLDED", 1 << 20)
    part = io.BytesIO()
    np.save(part, np.zeros(100_000))
    path = files.npz_of(tmp_path / "p.npz", {f"a{n}.npy": part.getvalue() for n in range(4)})
    assert "without compression" in called(["import", path], outside).stderr
    with pytest.raises(ValueError, match="without compression"):
        plain_files.check_entries(path)


def test_hdf5_is_walked_without_going_round(tmp_path, outside):  # noqa: F811
    h5py = pytest.importorskip("h5py", reason="HDF5 is read by h5py, of the extra cubes")
    with h5py.File(tmp_path / "p.h5", "w") as file:
        files.loops(file)
        file["g/cube"] = np.ones((3, 4, 5))
        here = file
        for _ in range(40):
            here = here.create_group("d")
    assert "32 deep" in called(["import", tmp_path / "p.h5"], outside).stderr
    with h5py.File(tmp_path / "p.h5", "a") as file:
        del file["d"]
    assert "wavelengths" in called(["import", tmp_path / "p.h5"], outside).stderr  # the cube is found, once


@pytest.mark.parametrize("kind", ["an npy with a pickle", "an npz with a pickle", "a pickle with another name"])
def test_no_file_of_arrays_is_code(kind, tmp_path, outside):  # noqa: F811
    assert called(["import", files.FILES[kind][0](tmp_path, outside)], outside).exit_code == 2
    assert not (outside / files.OWNED).exists()


def test_a_store_with_a_pipe_or_a_chunk_that_unfolds_is_refused(tmp_path, outside, monkeypatch):  # noqa: F811
    monkeypatch.setattr(plain_files, "SMALL", 1 << 16)
    path = files.zarr_cube(tmp_path)
    chunk = tmp_path / "cube.zarr" / "radiance" / "c" / "0" / "0" / "0"
    chunk.write_bytes(gzip.compress(bytes(1_000_000)))
    assert "decompresses from 1003 to 1000000 bytes" in called(["plan", path], outside).stderr
    chunk.unlink()
    os.mkfifo(chunk)
    assert "not a regular file" in called(["plan", path], outside).stderr


def test_a_table_and_a_list_are_of_a_bounded_length(tmp_path, outside):  # noqa: F811
    path = files.light("wavelength_nm,power\n" + "1,1\n" * 1_100_000)(tmp_path, outside)
    assert "is too large for a table" in called(["plan", path], outside).stderr
    path = files.swept("[" + "2," * 300_000 + "]")(tmp_path, outside)
    assert "lists more than 200000 values" in called(["plan", path], outside).stderr
    path = files.swept("[2, 4, 2]")(tmp_path, outside)
    assert "2 appears twice" in called(["plan", path], outside).stderr
