"""Do the seconds that a plan states come? Before this machine has run a pipeline's stages, and after.

    python benchmarks/plan_seconds.py [--only NAME ...] [--set NAME=VALUE ...]

Every shipped pipeline is planned and run twice into an archive, with a cache of its own, which is empty at first.
Seconds are thread time of the stages and of writing. Exit code 1 if a plan that this machine knows is off by more than
a factor of 1.5, or one that it does not know by more than 4.
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
KNOWN, UNKNOWN = 1.5, 4.0


def asked(*words: str) -> dict:
    """Return what a command of etendue prints as JSON."""
    found = subprocess.run([sys.executable, "-m", "etendue", *words, "--json"], capture_output=True, text=True)
    answer = json.loads(found.stdout) if found.stdout else {}
    if "stages" not in answer:
        raise RuntimeError(found.stdout or found.stderr)
    return answer


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", action="append", help="name of a pipeline; may be repeated")
    parser.add_argument("--set", action="append", default=[])
    given = parser.parse_args()
    names = given.only or sorted(path.stem for path in PIPELINES.glob("*.toml"))
    overrides = [word for one in given.set for word in ("--set", one)]
    wrong = 0
    print(f"{'pipeline':18s} {'known':6s} {'planned':>9s} {'came':>9s} {'ratio':>7s}   worst stage: planned, came")
    for name in names:
        with tempfile.TemporaryDirectory() as folder:
            os.environ["ETENDUE_CACHE"] = f"{folder}/cache"
            for turn in range(2):
                file, archive = str(PIPELINES / f"{name}.toml"), f"{folder}/archive{turn}"
                try:
                    plan = asked("plan", file, *overrides)
                    run = asked("run", file, *overrides, "--archive", archive, "--quiet", "--no-errors")
                except RuntimeError as error:
                    print(f"{name:18s} {' '.join(str(error).split())[:140]}", flush=True)
                    break
                path = Path(folder, "cache", "rates", "stages")
                rates = json.loads(path.read_text()) if path.exists() else {}
                per_byte = rates.get("writing", {}).get("0", 4e-9)
                rows = [
                    (abs(own["seconds"] - came), row["name"], own["seconds"], came)
                    for own, row in zip(plan["stages"], run["stages"], strict=True)
                    for came in [row["seconds"] + per_byte * own["bytes"]]
                ]
                total = sum(row[3] for row in rows)
                ratio, limit = plan["seconds"] / total, KNOWN if plan["seconds_known"] else UNKNOWN
                wrong += not 1 / limit <= ratio <= limit
                _, stage, planned, came = max(rows)
                said = "yes" if plan["seconds_known"] else "~"
                text = f"{name:18s} {said:6s} {plan['seconds']:9.2f} {total:9.2f} {ratio:7.2f}"
                print(f"{text}   {stage}: {planned:.2f}, {came:.2f}", flush=True)
    sys.exit(int(wrong > 0))


if __name__ == "__main__":
    main()
