"""Edits of the code between two runs of one archive: what can change a bit is computed again and named, anything else
is reused.

    python benchmarks/edits.py                      # 25 edits of the engine's list, 10 of present, cli and archive
    python benchmarks/edits.py --seed 4 --engine 50 --others 0
    python benchmarks/edits.py --table              # ten edits, one of each kind: which stages are computed again

In:  a temporary copy of the package, the only thing that is edited: an operator or a literal at a time, drawn by the
     seed.
Out: a line for each edit: where, what, cells computed and reused, the reason that the run gives; exit code 1 where one
     is not as it
should be. An edit with which nothing can be planned any more is drawn again, and counted in the last line.
"""

from __future__ import annotations

import argparse
import ast
import importlib.util
import json
import os
import random
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import etendue
from etendue.plan.identity.engine import ENGINE

SHOWN = ("present", "cli", "archive")
HOUSES = ("etendue", "etendue_camera", "etendue_lab")
PLUGIN = "etendue_demosaic_malvar"
OTHER = {
    ast.Add: ("+", "-"),
    ast.Sub: ("-", "+"),
    ast.Mult: ("*", "/"),
    ast.Div: ("/", "*"),
    ast.FloorDiv: ("//", "*"),
    ast.Mod: ("%", "*"),
    ast.Pow: ("**", "*"),
    ast.Lt: ("<", "<="),
    ast.LtE: ("<=", "<"),
    ast.Gt: (">", ">="),
    ast.GtE: (">=", ">"),
    ast.Eq: ("==", "!="),
    ast.NotEq: ("!=", "=="),
    ast.And: ("and", "or"),
    ast.Or: ("or", "and"),
}
CAMERA = """
name = "edits"
seed = 3
tolerance = 1e-4

[camera]
peak_qe = [0.36, 0.44, 0.40]
pixel_pitch = "2.6 um"
dsnu = "2 electron"

[[stages]]
use = "composite"
name = "scene"
white_luminance = "1000 cd m-2"
width = "96 um"
height = "96 um"
spacing = "1 um"
wavelength_from = "400 nm"
wavelength_to = "700 nm"
bin_width = "100 nm"

[[stages]]
use = "pixel"
rows = 32
columns = 32

[sweep]
f_number = [2, 5.6]
"""
BEFORE, BEHIND = (
    ("irradiance", "falloff", "diffraction", "diffusion"),
    (
        "mosaic",
        "exposure",
        "shot_noise",
        "read_noise",
        "adc",
        "linearise",
        "demosaic_bilinear",
        "sharpen",
        "resolution",
    ),
)


@dataclass(frozen=True)
class Edit:
    """One operator or literal of a file, and what stands there instead."""

    path: Path
    line: int
    start: int
    end: int
    old: str
    new: str

    def made(self) -> None:
        lines = self.path.read_text().splitlines(keepends=True)
        text = lines[self.line - 1]
        lines[self.line - 1] = text[: self.start] + self.new + text[self.end :]
        self.path.write_text("".join(lines))
        later = time.time() + 60  # bytecode is told from its source by the second
        os.utime(self.path, (later, later))


def edits_of(path: Path) -> Iterator[Edit]:
    """Everything in a file that may be edited."""
    text = path.read_text()
    lines = text.splitlines()
    for node in ast.walk(ast.parse(text)):
        pairs: list[tuple[ast.AST, ast.AST, type]] = []
        if isinstance(node, ast.BinOp):
            pairs = [(node.left, node.right, type(node.op))]
        elif isinstance(node, ast.Compare):
            pairs = list(zip([node.left, *node.comparators], node.comparators, map(type, node.ops), strict=False))
        elif isinstance(node, ast.BoolOp):
            pairs = [(a, b, type(node.op)) for a, b in zip(node.values, node.values[1:], strict=False)]
        elif isinstance(node, ast.Constant) and type(node.value) in (int, float) and node.lineno == node.end_lineno:
            old = lines[node.lineno - 1][node.col_offset : node.end_col_offset]
            if lines[node.lineno - 1].isascii() and old.strip("-")[:1].isdigit():
                yield Edit(path, node.lineno, node.col_offset, node.end_col_offset or 0, old, repr(node.value * 2 or 1))
        for left, right, kind in pairs:
            old, new = OTHER.get(kind, ("", ""))
            where, until = (
                (getattr(left, "end_lineno", 0), getattr(left, "end_col_offset", 0)),
                getattr(right, "lineno", 0),
            )
            if not old or where[0] != until or not lines[until - 1].isascii():
                continue
            between = lines[until - 1][where[1] : getattr(right, "col_offset", 0)]
            found = re.search(rf"(?<![\w<>=!*/]){re.escape(old)}(?![\w<>=*/])", between)
            if found:
                yield Edit(path, until, where[1] + found.start(), where[1] + found.end(), old, new)


class Bench:
    """A copy of the package, and an archive that was made with it."""

    def __init__(self, folder: Path, package: Path, demosaicer: str = "demosaic_bilinear") -> None:
        self.folder, self.package = folder, folder / "src" / "etendue"
        plugin = importlib.util.find_spec(PLUGIN)
        beside = [Path(str(plugin.origin)).parent] if plugin is not None else []
        for own in (*(package.parent / name for name in HOUSES), *beside):
            shutil.copytree(own, self.package.parent / own.name, ignore=shutil.ignore_patterns("__pycache__", ".*"))
        stages = {name: f'[[stages]]\nuse = "{name}"\n' for name in (*BEFORE, *BEHIND)}
        text = CAMERA.replace(
            '[[stages]]\nuse = "pixel"', "".join(stages[name] for name in BEFORE) + '[[stages]]\nuse = "pixel"'
        )
        behind = "".join(stages[name] for name in BEHIND).replace("demosaic_bilinear", demosaicer)
        (folder / "edits.toml").write_text(text.replace("[sweep]", f"{behind}\n[sweep]"))
        first = self.run("first")
        assert first is not None and first["computed"] and not first["reused"], first
        self.cells = first["computed"]
        again = self.run("first")
        assert again is not None and again["reused"] == self.cells and not again["computed"], again

    def run(self, archive: str) -> dict[str, object] | None:
        """What a run says of itself; None where it breaks off before anything is computed or reused."""
        path = os.pathsep.join([str(self.folder / "src"), *filter(None, [os.environ.get("PYTHONPATH")])])
        environment = {**os.environ, "PYTHONPATH": path, "ETENDUE_CACHE": str(self.folder / "cache")}
        asked = [
            "run",
            str(self.folder / "edits.toml"),
            "--archive",
            str(self.folder / archive),
            "--scheduler",
            "serial",
            "--json",
        ]
        done = subprocess.run(
            [sys.executable, "-m", "etendue", *asked],
            capture_output=True,
            text=True,
            env=environment,
            timeout=300,
            check=False,
            cwd=self.folder,
        )
        try:
            found: dict[str, object] = json.loads(done.stdout)
            return found if "computed" in found else None
        except ValueError:
            return None

    def tried(self, edit: Edit) -> dict[str, object] | None:
        """The same with one edit, on a copy of the archive."""
        kept, state = edit.path.read_bytes(), edit.path.stat()
        shutil.copytree(self.folder / "first", self.folder / "second")
        edit.made()
        try:
            return self.run("second")
        finally:
            edit.path.write_bytes(kept)
            os.utime(edit.path, ns=(state.st_atime_ns, state.st_mtime_ns))
            shutil.rmtree(self.folder / "second")


# what is edited, where, what stands there, what instead, and from which stage on cells are computed again: "" none,
# "all" all
TEN = (
    (
        "kernel",
        "etendue_camera/electronics/converter.py",
        "import numpy",
        "import  numpy",
        "read_noise",
    ),  # in one file with the converter
    ("stage", "etendue_camera/restoration/stages/sharpening.py", "annotations\n", "annotations  # edited\n", "sharpen"),
    ("engine, compute", "etendue/compute/given.py", "import", "import ", "all"),
    ("engine, plan", "etendue/plan/cost.py", "import", "import ", ""),
    ("laboratory", "etendue_lab/compare/study.py", "import", "import ", ""),
    ("page", "etendue/present/page/static/start.js", "function", "function ", ""),
    ("plugin's kernel", f"{PLUGIN}/kernel.py", "import", "import ", "demosaic_malvar"),
    ("plugin's page", f"{PLUGIN}/page.py", "", "PAGE = 2\n", ""),
    ("data table", "etendue_camera/data/silicon_absorption.csv", "\n", "\n\n", "diffusion"),
    ("docstring", "etendue_camera/electronics/converter.py", '"""', '""" ', "read_noise"),
)


def table(package: Path) -> int:
    """One edit of each kind: the stages whose cells are computed again beside those that should be."""
    order = [*(name for name in ("scene", *BEFORE, "pixel", *BEHIND))]
    order[order.index("demosaic_bilinear")] = "demosaic_malvar"
    wrong = 0
    with tempfile.TemporaryDirectory(prefix="etendue-edits-") as folder:
        bench = Bench(Path(folder), package, "demosaic_malvar")
        print(f"{bench.cells} cells\n{'edit of':16} {'computed':>8} {'reused':>7}  from stage        expected")
        for what, place, old, new, expected in TEN:
            path = bench.package.parent / place
            kept = path.read_bytes() if path.exists() else None
            shutil.copytree(bench.folder / "first", bench.folder / "second")
            path.write_text((kept or b"").decode().replace(old, new, 1) if old else new)
            later = time.time() + 60
            os.utime(path, (later, later))
            found = bench.run("second")
            shutil.rmtree(bench.folder / "second")
            path.unlink() if kept is None else path.write_bytes(kept)
            assert found is not None, what
            reasons = found["reasons"]
            assert isinstance(reasons, dict)
            again = {str(name).split()[0] for name in reasons}
            first = next((name for name in order if name in again), "") if found["computed"] else ""
            first = "all" if found["computed"] == bench.cells else first
            wrong += first != expected
            print(
                f"{what:16} {found['computed']:>8} {found['reused']:>7}  {first or 'none':17} {expected or 'none'}",
                flush=True,
            )
    print(f"{wrong} of {len(TEN)} not as they should be")
    return int(wrong > 0)


def engine_files(package: Path) -> list[Path]:
    return [package.parent / f"{module.replace('.', '/')}.py" for module in ENGINE]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seed", type=int, default=21)
    parser.add_argument("--engine", type=int, default=25, help="edits of modules that can change a bit of a cell")
    parser.add_argument("--others", type=int, default=10, help=f"edits of {', '.join(SHOWN)}")
    parser.add_argument("--table", action="store_true", help="ten edits, one of each kind, and no others")
    parser.add_argument("--package", type=Path, default=Path(etendue.__file__).parent, help="what is copied")
    asked = parser.parse_args()
    if asked.table:
        return table(asked.package)
    draw = random.Random(asked.seed)
    with tempfile.TemporaryDirectory(prefix="etendue-edits-") as folder:
        bench = Bench(Path(folder), asked.package)
        others = [path for room in SHOWN for path in sorted((bench.package / room).rglob("*.py"))]
        print(f"{bench.cells} cells; seed {asked.seed}\n{'place':28} {'edit':18} {'computed':>8} {'reused':>7}  reason")
        wrong = again = 0
        for files, count, engine in ((engine_files(bench.package), asked.engine, True), (others, asked.others, False)):
            bad, drawn = _drawn(bench, files, count, engine, draw)
            wrong, again = wrong + bad, again + drawn
        print(
            f"{wrong} of {asked.engine + asked.others} not as they should be; {again} more with which nothing can be "
            f"planned or read"
        )
    return int(wrong > 0)


def _drawn(bench: Bench, files: Iterable[Path], count: int, engine: bool, draw: random.Random) -> tuple[int, int]:
    """How many edits were not as they should be, and how many were drawn again."""
    every = [edit for path in files for edit in edits_of(path)]
    draw.shuffle(every)
    wrong = done = again = 0
    for edit in every:
        if done == count:
            break
        found = bench.tried(edit)
        if found is None:
            again += 1
            continue
        done += 1
        module = ".".join(edit.path.relative_to(bench.package.parent).with_suffix("").parts)
        reasons = found["reasons"]
        assert isinstance(reasons, dict)
        fine = (
            found["reused"] == 0 and all(module in text for text in reasons.values())
            if engine
            else found["reused"] == bench.cells
        )
        wrong += not fine
        where, what = f"{edit.path.relative_to(bench.package)}:{edit.line}", f"{edit.old} -> {edit.new}"
        reason = next(iter(sorted(set(reasons.values()), key=lambda text: module not in text)), "")
        print(
            f"{where:28} {what:18} {found['computed']:>8} {found['reused']:>7}  {reason}{'' if fine else '   WRONG'}",
            flush=True,
        )
    return wrong, again


if __name__ == "__main__":
    sys.exit(main())
