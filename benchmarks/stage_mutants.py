"""Slips in the kernels of built-in stages, one at a time: does ``etendue stability`` catch each of them?

    python benchmarks/stage_mutants.py                  # every slip of stage_mutants.json
    python benchmarks/stage_mutants.py adc blur         # those whose name or file contains one of the words
    python benchmarks/stage_mutants.py --laws-alone     # without the stored references and the closed forms

In:  stage_mutants.json: a text of a source file, what the slip makes of it, and the stages that should notice; a
     temporary copy of the sources, the only thing that is changed.
Out: a line for each slip: caught or survived, by which law of which stage, seconds; exit code 1 where one survived, or
     where a text no longer stands exactly once in its file. A slip that changes results by less than the stage's stated
     error would be counted apart; there is none.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

HOME = Path(__file__).parents[1]
TABLE = Path(__file__).with_suffix(".json")
TRYING = """
import sys
from etendue_lab.stability import kernels, references, stages
alone = sys.argv[1] == "alone"
if alone:
    references.row_of = lambda name, case: iter(())
names = sys.argv[2:]
for name in names:
    for row in stages.rows_of(name):
        if row.ok is False:
            sys.exit(f"{row.stage}, {row.law}, {row.case}")
for row in () if alone else kernels.rows_of_forms(frozenset(names)):
    if row.ok is False:
        sys.exit(f"{row.stage}, {row.law}, {row.case}")
"""


def tried(slip: dict[str, str], sources: Path, way: str) -> tuple[bool, str]:
    """Return whether the command accuses a stage that has a slip, and by which law."""
    place = sources / slip["file"].removeprefix("src/")
    whole = place.read_text(encoding="utf-8")
    if whole.count(slip["old"]) != 1:
        return False, f"its text stands {whole.count(slip['old'])} times in {slip['file']}"
    place.write_text(whole.replace(slip["old"], slip["new"]), encoding="utf-8")
    words = {**os.environ, "PYTHONPATH": str(sources), "PYTHONDONTWRITEBYTECODE": "1"}
    try:
        command = [sys.executable, "-c", TRYING, way, *slip["stages"].split()]
        done = subprocess.run(command, cwd=sources, env=words, capture_output=True, text=True, check=False)
    finally:
        place.write_text(whole, encoding="utf-8")
    return done.returncode == 1, (done.stderr.strip().splitlines() or [""])[-1][:120]


def main(words: list[str]) -> int:
    way = "alone" if "--laws-alone" in words else "all"
    words = [word for word in words if not word.startswith("-")]
    slips = json.loads(TABLE.read_text(encoding="utf-8"))
    slips = [s for s in slips if not words or any(word in s["name"] or word in s["file"] for word in words)]
    survived = 0
    with tempfile.TemporaryDirectory() as folder:
        sources = Path(folder) / "src"
        shutil.copytree(HOME / "src", sources, ignore=shutil.ignore_patterns("__pycache__"))
        for slip in slips:
            began = time.perf_counter()
            caught, what = tried(slip, sources, way)
            survived += not caught
            seconds = f"{time.perf_counter() - began:4.0f} s"
            print(f"{'caught  ' if caught else 'SURVIVED'} {seconds}  {slip['name']}: {what}", flush=True)
    print(f"{len(slips)} slips, {len(slips) - survived} caught, {survived} survived")
    return int(survived > 0)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
