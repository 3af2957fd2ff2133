"""Damage an archive in every way, many times: is the damage found, named and repaired?

In:  how many of each kind (default 20), a seed; kinds by name.
Out: a row per kind: how often it was found, named and repaired, the cells lost and the cells computed. Failures are
     listed below the table; the exit code is then 1.

    python benchmarks/faults/damages.py --count 20

What is lost is determined without etendue: cells of which a stored byte, or the journal line that confirms it, differs
from the sound archive. Repaired means: ``verify`` finds nothing, every array of every cell has its original bits, and
so has every file of the store that holds neither measured times nor chunks of cells. Only lost cells may be computed.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import shutil
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from damage_kinds import KINDS

from etendue.archive.checks.verify import verify
from etendue.archive.read.reading import open_archive
from etendue.archive.read.stored import Stored
from etendue.archive.records.remembered import remember
from etendue.contract.registry import installed_stages
from etendue.errors import EtendueError
from etendue.pipeline.file import read_pipeline
from etendue.plan.planner import make_plan
from etendue.session import Options, execute
from etendue.trust.repairing import repair

TEXT = """
name = "small"
[about]
license = "CC-BY-4.0"
author = "Lovelace, Ada"
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
use = "mosaic"
[[stages]]
use = "exposure"
[[stages]]
use = "lens_numbers"
[sweep]
f_number = [2, 4]
back = ["absorbing", "reflecting"]
integration_time = ["1 ms", "2 ms"]
"pixel.rows" = [4, 6]
"""
TABLE = "wavelength_nm,R,G,B\n" + "".join(f"{w},{0.1 + w / 4000},{0.2},{0.3}\n" for w in range(380, 781, 10))
TIMES = ("data.zarr/ledger/seconds/", "data.zarr/summary/seconds/")


@dataclass
class Sound:
    """An undamaged archive, and the places of its contents."""

    folder: Path
    source: Path
    other: Path  # the same pipeline with other numbers
    lines: list[bytes]
    places: dict[tuple[str, str, int], tuple[str, int, int]]  # (cell, variable, slot): file, offset, size
    arrays: dict[tuple[str, str], bytes]
    slots: dict[str, int]

    def shards(self) -> list[str]:
        """Return the files of several chunks."""
        return sorted(path for path in self.slots if len(self.in_file(path)) > 1)

    def in_file(self, path: str) -> list[tuple[int, int, int]]:
        """Return (slot, offset, size) of the chunks of a file, in the order in which they lie."""
        return sorted(
            ((slot, at, size) for (_, _, slot), (file, at, size) in self.places.items() if file == path),
            key=lambda one: one[1],
        )


def made(place: Path) -> Sound:
    """Make an archive by three runs: two values of an axis, then a third one, then other numbers elsewhere."""
    (place / "camera.csv").write_text(TABLE)
    (place / "small.toml").write_text(TEXT)
    folder, other = place / "sound", place / "other"
    for archive, overrides in (
        (folder, {}),
        (folder, {"sweep.f_number": [2, 8]}),
        (other, {"camera.transmittance": 0.5}),
    ):
        plan = make_plan(read_pipeline(place / "small.toml", overrides), installed_stages())
        execute(plan, archive, Options("serial"))
    remember(folder, "key", {"error": 0.25})
    stored = open_archive(folder)
    places, slots = {}, {}
    for name, cell in stored.cells.items():
        for chunk in cell.chunks:
            at = stored.place(chunk)
            assert at is not None
            places[name, chunk.variable, chunk.written.slot] = (at.file, at.offset, at.size)
            slots[at.file] = chunk.form.slots
    lines = (folder / "journal.jsonl").read_bytes().splitlines(keepends=True)
    return Sound(folder, place / "camera.csv", other, lines, places, arrays_of(folder), slots)


def arrays_of(folder: Path) -> dict[tuple[str, str], bytes]:
    """Return the bits of every array of every cell."""
    stored = Stored(folder)
    cells = {name: stored.cell(name) for name in stored.finished}
    return {
        (name, variable): cell.read(variable).tobytes() for name, cell in cells.items() for variable in cell.variables
    }


def last_words(lines: list[bytes], sound: set[bytes]) -> dict[str, bool]:
    """Return, by cell, whether the last line about it is ``done``; lines that the sound archive does not have are
    ignored.
    """
    found: dict[str, bool] = {}
    for line in lines:
        if line in sound:
            said = json.loads(line)
            if "cell" in said:
                found[said["cell"]] = said["event"] == "done"
    return found


def lost_cells(sound: Sound, archive: Path) -> set[str]:
    """Return the cells of which a byte, or the journal line that confirms it, has changed."""
    lost, files = set(), dict[str, tuple[bytes, bytes]]()
    for (cell, _, _), (file, at, size) in sound.places.items():
        if file not in files:
            path = archive / file
            files[file] = (
                (sound.folder / file).read_bytes(),
                path.read_bytes() if path.is_file() and not path.is_symlink() else b"",
            )
        was, now = files[file]
        if was[at : at + size] != now[at : at + size]:
            lost.add(cell)
    journal = archive / "journal.jsonl"
    lines = journal.read_bytes().splitlines(keepends=True) if journal.is_file() and not journal.is_symlink() else []
    words, whole = last_words(lines, set(sound.lines)), last_words(sound.lines, set(sound.lines))
    stored = {cell for cell, _, _ in sound.places}
    return lost | {cell for cell, done in whole.items() if done and cell in stored and not words.get(cell)}


@dataclass
class Row:
    """The results for one kind of damage."""

    count: int = 0
    found: int = 0
    named: int = 0
    repaired: int = 0
    lost: int = 0
    computed: int = 0
    more: int = 0  # how often more was computed than was lost
    wrong: list[str] = field(default_factory=list)


def trial(sound: Sound, archive: Path, kind: str, draw: random.Random, row: Row, where: str) -> None:
    """Damage an archive once, look for the damage, repair it, and check the result."""
    paths = KINDS[kind](sound, archive, draw)
    lost = lost_cells(sound, archive)
    row.count += 1
    found = verify(archive)
    row.found += not found.whole
    told = {damage.path for damage in found.damages}
    named = set(paths) <= told and lost <= set(found.lost)
    row.named += named
    if not named:
        row.wrong.append(f"{where}: not named: {sorted(set(paths) - told)} {sorted(lost - set(found.lost))[:3]}")
    row.lost += len(lost)
    try:
        done = repair(archive, [sound.source], Options("serial"))
    except EtendueError as error:
        row.wrong.append(f"{where}: not repaired: {error}")
        return
    row.computed += done.computed
    row.more += done.computed > len(lost)
    why = difference(sound, archive)
    if done.after.whole and not why:
        row.repaired += 1
    else:
        row.wrong.append(f"{where}: {why or [vars(damage) for damage in done.after.damages[:3]]}")


def difference(sound: Sound, archive: Path) -> str:
    """Return what differs between a repaired archive and the original; '' if nothing does."""
    arrays = arrays_of(archive)
    if arrays != sound.arrays:
        off = [key for key in {**arrays, **sound.arrays} if arrays.get(key) != sound.arrays.get(key)]
        return f"{len(off)} arrays differ, such as {off[0]}"
    own, was = (
        {
            p.relative_to(root).as_posix(): p.read_bytes()
            for p in (root / "data.zarr").rglob("*")
            if p.is_file() and p.relative_to(root).as_posix() not in sound.slots
        }
        for root in (archive, sound.folder)
    )
    off = [path for path in {**own, **was} if not path.startswith(TIMES) and own.get(path) != was.get(path)]
    return f"{off[0]} differs" if off else ""


def damaged(
    count: int, seed: int = 0, kinds: tuple[str, ...] = (), told: Callable[[str, Row], None] = lambda kind, row: None
) -> dict[str, Row]:
    """Apply every kind of damage this many times, each to a fresh copy; call ``told`` after each kind."""
    rows: dict[str, Row] = {}
    with tempfile.TemporaryDirectory() as place:
        sound = made(Path(place))
        assert verify(sound.folder).whole
        for kind in kinds or KINDS:
            rows[kind] = Row()
            for number in range(count):
                archive = Path(place) / "damaged"
                shutil.copytree(sound.folder, archive)
                trial(sound, archive, kind, random.Random(f"{seed} {kind} {number}"), rows[kind], f"{kind} {number}")
                shutil.rmtree(archive)
            told(kind, rows[kind])
    return rows


FIGURES = ("count", "found", "named", "repaired", "lost", "computed", "more")


def print_row(kind: str, row: Row) -> None:
    n, found, named, repaired, lost, computed, more = (getattr(row, name) for name in FIGURES)
    print(f"{kind:36s} {n:4d} {found:6d} {named:6d} {repaired:9d} {lost:11d} {computed:9d} {more:5d}", flush=True)


def main() -> None:
    words = argparse.ArgumentParser(description=__doc__)
    words.add_argument("--count", type=int, default=20)
    words.add_argument("--seed", type=int, default=0)
    words.add_argument("--kind", action="append", default=[], choices=list(KINDS))
    words.add_argument("--first", type=int, default=len(KINDS), help="only the first N kinds")
    asked = words.parse_args()
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    print(
        f"{'damage':36s} {'n':>4s} {'found':>6s} {'named':>6s} {'repaired':>9s} {'cells lost':>11s} {'computed':>9s} "
        f"{'more':>5s}"
    )
    rows = damaged(asked.count, asked.seed, tuple(asked.kind or list(KINDS)[: asked.first]), print_row)
    whole = Row(*(sum(getattr(row, name) for row in rows.values()) for name in FIGURES))
    print_row(f"{len(rows)} kinds", whole)
    wrong = [text for row in rows.values() for text in row.wrong]
    for text in wrong[:40]:
        print(text)
    sys.exit(1 if wrong else 0)


if __name__ == "__main__":
    main()
