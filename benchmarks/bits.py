"""A digest of every array of every shipped pipeline: two lists of it, of two commits, say which bits changed.

    python benchmarks/bits.py > after.json [--only paper sweep]
    python benchmarks/bits.py --against before.json

Axis values, tables of a run and pictures are left out; what is left is what the physics gave. ``--common``: with random
numbers that do not depend on parameter values, so that a change of what keys them changes nothing.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
TABLES = ("ledger", "summary", "frames")


def digests(file: Path, common: bool) -> dict[str, str]:
    """Digest by ``stage/variable`` (shape groups joined into it) of one pipeline; the fault where it does not run."""
    import etendue
    from etendue.errors import EtendueError
    from etendue.session import load

    try:
        tree = etendue.simulate(load(file, {"camera.noise": "common"} if common else None))
    except EtendueError as error:
        return {"fault": str(error).split("\n")[0][:200]}
    found = {}
    for node in tree.subtree:
        if node.path.strip("/").split("/")[0] in TABLES:
            continue
        for name, array in node.to_dataset(inherit=False).data_vars.items():
            values = array.values
            if values.dtype.kind not in "fiub":
                values = values.astype(str)
            text = f"{values.dtype} {array.dims} {values.shape}".encode()
            found[f"{node.path.strip('/')}/{name}"] = hashlib.sha256(text + values.tobytes()).hexdigest()[:16]
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", nargs="*", default=[])
    parser.add_argument("--folder", type=Path, default=ROOT / "pipelines")
    parser.add_argument("--against", type=Path)
    parser.add_argument("--common", action="store_true")
    arguments = parser.parse_args()
    files = [f for f in sorted(arguments.folder.glob("*.toml")) if not arguments.only or f.stem in arguments.only]
    now = {}
    for file in files:
        print(file.stem, file=sys.stderr, flush=True)
        now[file.stem] = digests(file, arguments.common)
    if not arguments.against:
        print(json.dumps(now, indent=1, sort_keys=True))
        return
    then = json.loads(arguments.against.read_text())
    for name in now:
        old, new = then.get(name, {}), now[name]
        same = [path for path in new if old.get(path) == new[path]]
        print(f"{name}: {len(same)} of {len(new)} arrays have the same bits")
        for path in sorted(set(old) | set(new)):
            if old.get(path) != new.get(path):
                print(f"  {path}: {old.get(path, 'was not there')} -> {new.get(path, 'is no longer there')}")


if __name__ == "__main__":
    main()
