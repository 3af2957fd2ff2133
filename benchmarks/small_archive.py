"""What an archive costs beside its run: CPU of a camera of 4 x 4 pixels in a warm process, and what it makes.

    python benchmarks/small_archive.py [--repeats 9] [--place FOLDER]

Rows: the run in memory and into a new archive, milliseconds of CPU without planning, least of the repeats in turn.
Below: the files and folders of the archive. ``--place``: where archives are made, such as a file system in memory.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import time
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).parent.parent))

from etendue.session import execute
from tests.designs.given import SERIAL, STAGES, plan_of


def spent(archive: Path | None) -> float:
    """Return the CPU milliseconds of one run."""
    plan = plan_of(text=STAGES)
    began = time.process_time()
    assert not execute(plan, archive, SERIAL).failed
    return 1e3 * (time.process_time() - began)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeats", type=int, default=9)
    parser.add_argument("--place", type=Path)
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory(dir=asked.place) as folder:
        spent(None), spent(Path(folder, "warm"))
        found = [(spent(None), spent(Path(folder, str(n)))) for n in range(asked.repeats)]
        memory, archived = (min(column) for column in zip(*found, strict=True))
        made = [path.is_file() for path in Path(folder, "0").rglob("*")]
    print(
        f"in memory {memory:.1f} ms, archived {archived:.1f} ms of CPU; "
        f"{made.count(True)} files, {made.count(False)} folders"
    )


if __name__ == "__main__":
    main()
