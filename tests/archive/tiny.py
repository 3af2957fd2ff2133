"""The smallest archive that has something of everything: groups by shape, a file, text and number axes, tables,
pictures.
"""

from __future__ import annotations

import json
from math import prod
from pathlib import Path
from typing import Any

import google_crc32c
import numpy as np

from etendue.contract.registry import installed_stages
from etendue.pipeline.file import read_pipeline
from etendue.plan.model import Plan
from etendue.plan.planner import make_plan

TEXT = """
name = "tiny"

[camera]
pixel_pitch = "3 um"
peak_qe = [0.36, 0.44, 0.40]
sensitivity = "camera.csv"

[[stages]]
use = "slanted_edge"
name = "scene"
white_luminance = "1000 cd m-2"
width = "20 um"
height = "20 um"
bin_width = "100 nm"
[[stages]]
use = "irradiance"
[[stages]]
use = "pixel"
rows = 4
columns = 4
[[stages]]
use = "lens_numbers"

[sweep]
f_number = [2, 4]
back = ["absorbing", "reflecting"]
"pixel.rows" = [4, 5]
"""
TABLE = "wavelength_nm,R,G,B\n" + "".join(f"{w},{0.1 + w / 4000},{0.2},{0.3}\n" for w in range(380, 781, 10))
LARGEST, SMALL = 5 << 10, 1 << 10  # bytes: what is large, and too small to be compressed, in these tests
MEASURED = ("ledger/seconds/", "summary/seconds/")


def tiny_file(folder: Path, text: str = TEXT) -> Path:
    (folder / "camera.csv").write_text(TABLE)
    (folder / "tiny.toml").write_text(text)
    return folder / "tiny.toml"


def tiny_plan(folder: Path, overrides: dict[str, Any] | None = None) -> Plan:
    return make_plan(read_pipeline(tiny_file(folder), overrides or {}), installed_stages())


def store_of(archive: Path) -> dict[str, bytes]:
    """Every file of the store but measured times: what must be equal, to the last byte.

    Of a shard every chunk by its slot, as its index names it: the order in which chunks lie is the order in which cells
    ended.
    """
    root = archive / "data.zarr"
    found = {p.relative_to(root).as_posix(): p.read_bytes() for p in root.rglob("*") if p.is_file()}
    found = {path: data for path, data in found.items() if not path.startswith(MEASURED)}
    for path in [path for path in found if path.split("/")[-1].startswith("c.") and "/c/" not in path]:
        slots = slots_of(json.loads(found[path.rpartition("/")[0] + "/zarr.json"]))
        if slots:
            data = found.pop(path)
            found |= {f"{path}#{slot}": data[at : at + size] for slot, (at, size) in index_of(data, slots).items()}
    return found


def slots_of(metadata: dict[str, Any]) -> int:
    """How many chunks a shard of an array has room for; 0: it has no shards."""
    codec = metadata["codecs"][0]
    if codec["name"] != "sharding_indexed":
        return 0
    return prod(
        a // b
        for a, b in zip(
            metadata["chunk_grid"]["configuration"]["chunk_shape"], codec["configuration"]["chunk_shape"], strict=True
        )
    )


def index_of(shard: bytes, slots: int) -> dict[int, tuple[int, int]]:
    """Offset and size by slot, from the bytes of a shard."""
    index = np.frombuffer(shard[-16 * slots - 4 : -4], "<u8").reshape(slots, 2)
    assert google_crc32c.value(shard[-16 * slots - 4 : -4]).to_bytes(4, "little") == shard[-4:]
    return {slot: (int(at), int(size)) for slot, (at, size) in enumerate(index) if at != 2**64 - 1}
