"""Slips that a hand makes, one at a time: does a law catch each of them?

    python benchmarks/mutants.py                 # every slip of mutants.json, each with the laws named there
    python benchmarks/mutants.py bound journal   # those whose name or file contains one of the words

In:  mutants.json: a text of a source file, what the slip makes of it, and the laws that should break; a temporary copy
     of the sources, the only thing that is changed.
Out: a line for each slip: caught or survived, by what, seconds; exit code 1 where one survived, or where a text no
     longer stands exactly once in its file.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

HOME = Path(__file__).parents[1]
TABLE = Path(__file__).with_suffix(".json")
FEW = ("-n", "0", "-x", "-q", "-m", "long or not long", "-p", "no:cacheprovider", "--tb", "no")


def tried(slip: dict[str, str], sources: Path) -> tuple[bool, str]:
    """Return whether laws break with a slip, and the first that does, or why it could not be tried."""
    place = sources / slip["file"].removeprefix("src/")
    whole = place.read_text(encoding="utf-8")
    if whole.count(slip["old"]) != 1:
        return False, f"its text stands {whole.count(slip['old'])} times in {slip['file']}"
    place.write_text(whole.replace(slip["old"], slip["new"]), encoding="utf-8")
    try:
        done = laws(slip["laws"].split(), sources)
    finally:
        place.write_text(whole, encoding="utf-8")
    found = re.search(r"^(?:FAILED|ERROR) (\S+)", done.stdout, re.MULTILINE)
    if done.returncode not in (0, 1):
        return False, (done.stdout + done.stderr).strip().splitlines()[-1]
    return done.returncode == 1, found[1] if found else ""


def laws(names: list[str], sources: Path) -> subprocess.CompletedProcess[str]:
    """Run laws on a copy of the sources; no compiled file of one slip is taken for that of the next."""
    words = {**os.environ, "PYTHONPATH": str(sources), "PYTHONDONTWRITEBYTECODE": "1"}
    command = [sys.executable, "-m", "pytest", *FEW, *names]
    return subprocess.run(command, cwd=HOME, env=words, capture_output=True, text=True, check=False)


def main(words: list[str]) -> int:
    slips = json.loads(TABLE.read_text(encoding="utf-8"))
    slips = [s for s in slips if not words or any(word in s["name"] or word in s["file"] for word in words)]
    survived = 0
    with tempfile.TemporaryDirectory() as folder:
        sources = Path(folder) / "src"
        shutil.copytree(HOME / "src", sources, ignore=shutil.ignore_patterns("__pycache__"))
        for slip in slips:
            began = time.perf_counter()
            caught, what = tried(slip, sources)
            survived += not caught
            seconds = f"{time.perf_counter() - began:4.0f} s"
            print(f"{'caught  ' if caught else 'SURVIVED'} {seconds}  {slip['name']}: {what}", flush=True)
    print(f"{len(slips)} slips, {len(slips) - survived} caught, {survived} survived")
    return int(survived > 0)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
