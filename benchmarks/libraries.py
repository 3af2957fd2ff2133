"""Two libraries in the place of two rooms of ours: what each would cost and give (docs/decisions/0073).

    python benchmarks/libraries.py [--rounds 5]

rocrate against archive/records/crate.py: seconds of import, whether an archive's crate comes out of it as it went in.
distributed.LocalCluster (``--scheduler distributed``) against ``processes``: seconds of a run of paper.toml.
The least of all rounds; rocrate is no dependency: pip install rocrate.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

PAPER = Path(__file__).parents[1] / "pipelines" / "paper.toml"
CRATE = """
import json, sys
from rocrate.rocrate import ROCrate
json.dump(ROCrate(sys.argv[1]).metadata.generate(), sys.stdout)
"""


def seconds(rounds: int, *words: str) -> float:
    found = []
    for _ in range(rounds):
        begun = time.perf_counter()
        subprocess.run([sys.executable, *words], check=True, capture_output=True)
        found.append(time.perf_counter() - begun)
    return min(found)


def run_paper(folder: Path, scheduler: str) -> None:
    words = ["run", str(PAPER), "--archive", str(folder), "--recompute", "--quiet", "--scheduler", scheduler]
    subprocess.run([sys.executable, "-m", "etendue", *words, "--workers", "2"], check=True, capture_output=True)


def crates(folder: Path) -> None:
    own = json.loads((folder / "ro-crate-metadata.json").read_text())
    given = subprocess.run([sys.executable, "-c", CRATE, str(folder)], check=True, capture_output=True, text=True)
    theirs = json.loads(given.stdout)
    ours, back = ({one["@id"]: one for one in document["@graph"]} for document in (own, theirs))
    changed = [name for name in ours if ours[name] != back.get(name)]
    print(f"entities {len(ours)}, changed by rocrate {len(changed)}: {' '.join(changed)}")
    print(f"context kept {own['@context'] == theirs['@context']}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=5)
    rounds = parser.parse_args().rounds
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place) / "paper"
        for scheduler in ("processes", "distributed"):
            runs = []
            for _ in range(rounds):
                begun = time.perf_counter()
                run_paper(folder, scheduler)
                runs.append(time.perf_counter() - begun)
            print(f"paper.toml, {scheduler:12}        {min(runs):.2f} s")
        alone = seconds(rounds, "-c", "")
        if importlib.util.find_spec("rocrate") is None:
            print("rocrate is not installed: pip install rocrate")
            return
        print(f"import of rocrate               {seconds(rounds, '-c', 'import rocrate.rocrate') - alone:.2f} s")
        crates(folder)


if __name__ == "__main__":
    main()
