"""What an archive is on disk, and what it costs to write and read it: files, bytes, small chunks, one cell through
plain xarray.

    etendue run pipelines/sweep.toml --archive /tmp/sweep --quiet && python benchmarks/archive.py /tmp/sweep

Bytes are set beside the same chunks raw, and beside all of them through lz4 (what archives with a file for every cell
did). CPU time, smallest of the repeats.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
import warnings
from pathlib import Path

import numpy as np

CELLS = 4096


def best(work, repeats):  # type: ignore[no-untyped-def]
    """Smallest CPU time of some repeats, in ms."""
    found = []
    for _ in range(repeats):
        began = time.process_time()
        work()
        found.append(1e3 * (time.process_time() - began))
    return min(found)


def small_chunks() -> float:
    """Microseconds for a chunk of 1 kB: encoded, checksummed, appended, settled every 100 cells."""
    from etendue.archive.sharding.chunks import RAW, CellFiles, Chunk
    from etendue.archive.sharding.segments import PARTS

    folder, array = tempfile.mkdtemp(), np.random.default_rng(1).random(256).astype("f4")
    (Path(folder) / "run.id").write_text("own")

    def work() -> None:
        path = f"data.zarr/{time.monotonic_ns()}/v/c.0.0"
        for slot in range(CELLS):
            target = CellFiles(folder, "own", (Chunk("v", path, slot, CELLS, "float32", (256,), RAW),))
            target.write({"v": array})
            if slot % 100 == 99:
                target.settle()

    found = 1e3 * best(work, 5) / CELLS
    PARTS.close(folder)
    return found


def bytes_of(folder: Path) -> tuple[int, int, int]:
    """Bytes of all chunks: as stored, raw, and through lz4 (of one cell in five)."""
    from etendue.archive.read.reading import open_archive
    from etendue.archive.sharding.chunks import encode

    archive, stored, raw, packed = open_archive(folder), 0, 0, 0.0
    seen: dict[tuple[str, str], list[float]] = {}
    for number, cell in enumerate(archive.cells.values()):
        for chunk in cell.chunks:
            stored += chunk.written.size
            size = int(np.prod(chunk.form.shape)) * np.dtype(chunk.form.dtype).itemsize // chunk.form.pieces
            raw += size
            own = seen.setdefault((chunk.group, chunk.variable), [0.0, 0.0, 0.0])
            own[2] += size
            if (number % 5 == 0 or not own[0]) and chunk.form.pieces == 1:
                own[0] += size
                own[1] += len(encode(archive.read(cell, chunk.variable)))
    for sampled, compressed, whole in seen.values():
        packed += whole * compressed / sampled if sampled else whole
    return stored, raw, round(packed)


def main() -> None:
    import xarray

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("archive", type=Path)
    folder = parser.parse_args().archive
    warnings.simplefilter("error")
    files = sum(1 for p in folder.rglob("*") if p.is_file())
    arrays = sum(json.loads(p.read_text())["node_type"] == "array" for p in (folder / "data.zarr").rglob("zarr.json"))
    print(f"files {files}, arrays {arrays}   (goal: files <= 2 x arrays + 100 = {2 * arrays + 100})")
    stored, raw, packed = bytes_of(folder)
    print(
        f"chunks {stored / 1e6:.1f} MB; raw {raw / 1e6:.1f} MB; all of them through lz4 {packed / 1e6:.1f} MB: "
        f"{stored / packed:.2f} x"
    )
    print(f"a chunk of 1 kB: {small_chunks():.1f} us   (goal <= 10 us)")
    store = str(folder / "data.zarr")
    tree = xarray.open_datatree(store, engine="zarr")
    print(f"open_datatree {best(lambda: xarray.open_datatree(store, engine='zarr'), 5):.1f} ms")
    found = [(node, v) for node in tree.subtree for v in node.data_vars.values() if v.dims[-2:] == ("y", "x")]
    for node, array in sorted(found, key=lambda one: one[1].nbytes)[-3:]:
        own = [d for d in array.dims if d in node["status"].dims] if "status" in node else []
        at = {d: array.sizes[d] // 2 for d in own}
        one = array.isel(at)
        print(
            f"one cell of {node.path}/{array.name}, {one.nbytes / 1e3:.0f} kB: "
            f"{best(lambda a=array, i=at: a.isel(i).values, 15):.2f} ms"
        )


if __name__ == "__main__":
    main()
