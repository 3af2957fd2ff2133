"""What stating the errors of an answer costs: CPU seconds beside those of the stages, cold and remembered.

    python benchmarks/stating.py [--repeats 3]

Every run is a process of its own with an archive of its own. "cold": with an empty cache; "again": the same run with
the cache of the one before. Columns: CPU seconds of stating, seconds of all stages, the share, and the variables that
have a complete error. Allowed: 0.25 s for paper.toml, a tenth of the stages for sweep.toml, nothing again. Exit code 1
beyond them.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")
PIPELINES = Path(__file__).parent.parent / "pipelines"
CASES = (("paper", ()), ("sweep", ("--tolerance", "1e-2")), ("sweep", ("--nothing-left-out",)))
SMALL, SHARE, AGAIN = 0.25, 0.1, 0.01  # allowed: seconds of a short run, share of a long one, seconds when remembered


def run(name: str, options: tuple[str, ...], archive: Path) -> tuple[float, float, int, int]:
    """Return the seconds of stating and of the stages, and how many variables have a complete error, of how many."""
    words = ["run", str(PIPELINES / f"{name}.toml"), "--archive", str(archive), "--quiet", "--json", *options]
    found = json.loads(subprocess.check_output([sys.executable, "-m", "etendue", *words], text=True))
    answer = found["answer"]
    errors = answer["errors"].values()
    complete = sum(set(one["open"]) <= {"noise"} for one in errors)
    stating = 0.0 if answer["remembered"] else answer["seconds"]
    return stating, sum(one["seconds"] for one in found["stages"]), complete, len(errors)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeats", type=int, default=3)
    given = parser.parse_args()
    wrong = 0
    print(f"{'pipeline':8} {'options':20} {'':6} {'stating':>8} {'stages':>8} {'share':>7}  complete")
    for name, options in CASES:
        for _ in range(given.repeats):
            with tempfile.TemporaryDirectory() as folder:
                os.environ["ETENDUE_CACHE"] = f"{folder}/cache"
                for turn in ("cold", "again"):
                    stating, stages, complete, every = run(name, options, Path(folder, turn))
                    allowed = AGAIN if turn == "again" else max(SMALL, SHARE * stages)
                    wrong += stating > allowed
                    share = 100 * stating / stages
                    text = f"{name:8} {' '.join(options):20} {turn:6} {stating:8.3f} {stages:8.2f} {share:5.1f} %"
                    print(f"{text}  {complete} of {every}", flush=True)
    sys.exit(int(wrong > 0))


if __name__ == "__main__":
    main()
