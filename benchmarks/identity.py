"""Check that every array has the same digest, however it is computed and stored.

    python benchmarks/identity.py [--pipeline pipelines/smallest.toml] [--only threads]

In:  a pipeline, run in every way of the table, each in its own process and archive: schedulers, workers, batches, hash
     seeds, killed and resumed, grown, compacted, in strips, in bands.
Out: the ways and their CPU seconds; then every array of the stages with its digest, or the digests that differ and the
     ways that give them. Exit code 1 if any differ.

Compacted: the archive is rewritten by `compact` and read there. Grown: a run of the middle value of every axis, then of
all values. Strips: frames of any size are processed in strips of eight rows after the sensor, as frames above 2 Mpixel
are. Bands: cells of any size are stored in bands of rows, as those above 64 MB are.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
TABLES = ("ledger", "summary", "frames")


@dataclass(frozen=True)
class Way:
    """One way to run the pipeline."""

    scheduler: str = "serial"
    workers: int = 1
    batch_seconds: float = 0.1
    hash_seed: int = 0
    killed: bool = False  # killed with kill -9 during the run, then run again
    grown: bool = False
    compacted: bool = False
    strips: bool = False
    bands: bool = False

    def __str__(self) -> str:
        more = [name for name in ("killed", "grown", "compacted", "strips", "bands") if getattr(self, name)]
        told = f"{self.scheduler} x {self.workers}, batches of {self.batch_seconds:g} s, hash seed {self.hash_seed}"
        return " ".join([told, *more])


WAYS = (
    Way(),
    Way(hash_seed=1),
    Way(batch_seconds=0.0),
    Way(batch_seconds=1e3),
    Way(killed=True),
    Way(compacted=True),
    Way(grown=True, compacted=True),
    Way(strips=True),
    Way(strips=True, batch_seconds=1e3, hash_seed=2),
    *(Way("threads", n, hash_seed=n) for n in (1, 2, 4)),
    Way("threads", 2, 0.0),
    Way("threads", 4, 0.01, 3, killed=True, compacted=True),
    Way("threads", 2, strips=True),
    Way(bands=True),
    Way("threads", 2, bands=True, strips=True, grown=True, compacted=True),
    *(Way("processes", n, hash_seed=n) for n in (1, 2, 4)),
    Way("processes", 2, 0.0),
    Way("processes", 2, 0.01, 3, killed=True),
    *(Way("distributed", n, hash_seed=n) for n in (1, 2, 4)),
    Way("distributed", 2, 0.0),
    Way("distributed", 2, 0.01, 3, killed=True),
)
PROGRAM = """
import json, sys
from pathlib import Path

def main(pipeline, archive, overrides, strips, bands, options):
    from etendue.plan.planner import make_plan
    from etendue.contract.registry import installed_stages
    from etendue.archive.structure import cutting
    from etendue.compute import rows as cut
    from etendue.session import Options, execute, load

    if strips:
        cut.LARGEST_WHOLE, cut.STRIP, cut.TILE, cut.HALOS = 0, 1, 8, 2
    if bands:
        cutting.LARGEST_CHUNK = 4096
    made = execute(make_plan(load(Path(pipeline), overrides), installed_stages()), archive, Options(**options))
    sys.exit(len(made.failed) and 3)

if __name__ == "__main__":
    main(*json.loads(sys.argv[1]))
"""


def once(pipeline: Path, archive: Path, way: Way, overrides: dict[str, Any]) -> subprocess.Popen[bytes]:
    options = {"scheduler": way.scheduler, "workers": way.workers, "batch_seconds": way.batch_seconds}
    given = json.dumps([str(pipeline), str(archive), overrides, way.strips, way.bands, options])
    env = {**os.environ, "PYTHONHASHSEED": str(way.hash_seed)}
    return subprocess.Popen(
        [sys.executable, str(archive.parent / "program.py"), given], env=env, stderr=subprocess.PIPE
    )


def run(pipeline: Path, archive: Path, way: Way) -> Path:
    """Run the pipeline in one way and return its archive. A run is killed once it has finished some of its cells.

    Raises
    ------
    RuntimeError
        A run fails, or ends before it could be killed.
    """
    (archive.parent / "program.py").write_text(PROGRAM)
    if way.grown:
        axes = tomllib.loads(pipeline.read_text())["sweep"]
        ended(
            once(
                pipeline,
                archive,
                way,
                {f"sweep.{axis}": [values[(len(values) - 1) // 2]] for axis, values in axes.items()},
            ),
            way,
        )
    if way.killed:
        process, journal = once(pipeline, archive, way, {}), archive / "journal.jsonl"
        while process.poll() is None and not (journal.exists() and journal.read_bytes().count(b'"done"') > 20):
            time.sleep(0.002)
        process.send_signal(signal.SIGKILL)
        process.communicate()
        if process.returncode != -signal.SIGKILL:
            raise RuntimeError(f"{way}: ended before it was killed")
    ended(once(pipeline, archive, way, {}), way)
    if way.compacted:
        subprocess.run(
            [sys.executable, "-m", "etendue", "compact", archive, f"{archive}-compact"],
            check=True,
            stdout=subprocess.DEVNULL,
        )
    return Path(f"{archive}-compact") if way.compacted else archive


def ended(process: subprocess.Popen[bytes], way: Way) -> None:
    _, said = process.communicate()
    if process.returncode:
        raise RuntimeError(f"{way}: {said.decode()}")


def digests(archive: Path) -> Iterator[tuple[str, str]]:
    """Yield every array of the stages with its digest; the only shape of a stage is not named, because grown archives
    store it in the stage's own group.
    """
    import xarray

    with xarray.open_datatree(archive / "data.zarr", engine="zarr", chunks=None) as tree:
        for node in tree.subtree:
            stage, *child = node.path.strip("/").split("/")
            if stage in TABLES:
                continue
            place = stage if child and len(tree[stage].children) == 1 else "/".join([stage, *child])
            for name, array in node.to_dataset(inherit=False).data_vars.items():
                values = array.values if array.dtype.kind in "fiub" else array.values.astype(str)
                text = f"{values.dtype} {array.dims} {values.shape}".encode()
                yield f"{place}/{name}", hashlib.sha256(text + values.tobytes()).hexdigest()[:16]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--pipeline", type=Path, default=ROOT / "pipelines" / "smallest.toml")
    parser.add_argument("--only", nargs="*", help="schedulers to compare with one serial run")
    given = parser.parse_args()
    found: dict[str, dict[str, list[Way]]] = {}
    ways = [way for way in WAYS if not given.only or way == Way() or way.scheduler in given.only]
    with tempfile.TemporaryDirectory() as place:
        for number, way in enumerate(ways):
            began = sum(os.times()[:4])
            for array, digest in digests(run(given.pipeline, Path(place) / str(number), way)):
                found.setdefault(array, {}).setdefault(digest, []).append(way)
            print(f"{way}: {sum(os.times()[:4]) - began:.1f} s of CPU", flush=True)
    one = 0
    for array, by_digest in sorted(found.items()):
        ((first, agree), *others) = sorted(by_digest.items(), key=lambda item: -len(item[1]))
        print(f"{array:40s} {first}")
        one += not others and len(agree) == len(ways)
        for digest, differ in others:
            print(f"{'':40s} {digest} by {'; '.join(map(str, differ))}")
    print(f"{one} of {len(found)} arrays have the same digest in all {len(ways)} ways")
    return 0 if one == len(found) else 1


if __name__ == "__main__":
    sys.exit(main())
