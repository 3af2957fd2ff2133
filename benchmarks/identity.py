"""One digest per array, whoever computes it: schedulers, workers, batch sizes, hash seeds, killed and resumed or not.

    python benchmarks/identity.py [--pipeline pipelines/smallest.toml]

In:  a pipeline, run in every way of the table, each in a process of its own and an archive of its own.
Out: the ways; then every array of the stages with its one digest, or the digests that differ and by which ways. Exit code 1 if any do.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
TABLES = ("ledger", "summary", "frames")


@dataclass(frozen=True)
class Way:
    """How a run is done."""

    scheduler: str = "serial"
    workers: int = 1
    batch_seconds: float = 0.1
    hash_seed: int = 0
    killed: bool = False  # killed -9 under way, and run again

    def __str__(self) -> str:
        again = ", killed and resumed" if self.killed else ""
        return f"{self.scheduler} x {self.workers}, batches of {self.batch_seconds:g} s, hash seed {self.hash_seed}{again}"


WAYS = (
    Way(), Way(hash_seed=1), Way(batch_seconds=0.0), Way(batch_seconds=1e3), Way(killed=True),
    *(Way("threads", n, hash_seed=n) for n in (1, 2, 4)), Way("threads", 2, 0.0), Way("threads", 4, 0.01, 3, True),
    *(Way("processes", n, hash_seed=n) for n in (1, 2, 4)), Way("processes", 2, 0.0), Way("processes", 2, 0.01, 3, True),
    *(Way("distributed", n, hash_seed=n) for n in (1, 2, 4)), Way("distributed", 2, 0.0), Way("distributed", 2, 0.01, 3, True),
)  # fmt: skip


def once(pipeline: Path, archive: Path, way: Way) -> subprocess.Popen[bytes]:
    program = (
        "import sys; from pathlib import Path; from etendue.plan.planner import make_plan; from etendue.registry import installed_stages; "
        "from etendue.session import Options, execute, load; "
        "execute(make_plan(load(Path(sys.argv[1])), installed_stages()), sys.argv[2], "
        f"Options(scheduler={way.scheduler!r}, workers={way.workers}, batch_seconds={way.batch_seconds!r}))"
    )
    guarded = f"if __name__ == '__main__':\n    {program}"
    env = {**os.environ, "PYTHONHASHSEED": str(way.hash_seed)}
    return subprocess.Popen([sys.executable, "-c", guarded, str(pipeline), str(archive)], env=env, stderr=subprocess.PIPE)


def run(pipeline: Path, archive: Path, way: Way) -> None:
    """One way, to its end; one that is killed has finished some cells by then and not all."""
    process = once(pipeline, archive, way)
    if way.killed:
        journal = archive / "journal.jsonl"
        while process.poll() is None and not (journal.exists() and journal.read_bytes().count(b'"done"') > 20):
            time.sleep(0.005)
        process.send_signal(signal.SIGKILL)
        process.communicate()
        process = once(pipeline, archive, way)
    _, said = process.communicate()
    if process.returncode:
        raise SystemExit(f"{way}: {said.decode()}")


def digests(archive: Path) -> Iterator[tuple[str, str]]:
    """Every array of the stages and its digest."""
    import xarray

    with xarray.open_datatree(archive / "data.zarr", engine="zarr", chunks=None) as tree:
        for node in tree.subtree:
            if node.path.strip("/").split("/")[0] in TABLES:
                continue
            for name, array in node.to_dataset(inherit=False).data_vars.items():
                values = array.values if array.dtype.kind in "fiub" else array.values.astype(str)
                text = f"{values.dtype} {array.dims} {values.shape}".encode()
                yield f"{node.path.strip('/')}/{name}", hashlib.sha256(text + values.tobytes()).hexdigest()[:16]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--pipeline", type=Path, default=ROOT / "pipelines" / "smallest.toml")
    parser.add_argument("--only", nargs="*", help="schedulers; serial is always there")
    given = parser.parse_args()
    found: dict[str, dict[str, list[Way]]] = {}
    ways = [way for way in WAYS if not given.only or way.scheduler in ("serial", *given.only)]
    with tempfile.TemporaryDirectory() as place:
        for number, way in enumerate(ways):
            print(way, flush=True)
            run(given.pipeline, Path(place) / str(number), way)
            for array, digest in digests(Path(place) / str(number)):
                found.setdefault(array, {}).setdefault(digest, []).append(way)
    one = 0
    for array, by_digest in sorted(found.items()):
        ((first, agree), *others) = sorted(by_digest.items(), key=lambda item: -len(item[1]))
        print(f"{array:40s} {first}")
        one += not others and len(agree) == len(ways)
        for digest, differ in others:
            print(f"{'':40s} {digest} by {'; '.join(map(str, differ))}")
    print(f"{one} of {len(found)} arrays have one digest in {len(ways)} ways")
    return 0 if one == len(found) else 1


if __name__ == "__main__":
    sys.exit(main())
