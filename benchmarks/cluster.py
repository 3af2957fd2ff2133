"""What a Dask cluster costs by the number of cells: memory of scheduler and client, processor time of each a cell.

    python benchmarks/cluster.py 1000 10000 30000

Two workers of one thread, cells of 32 x 32 values that take no time, two in a batch, all kept in an archive. Beside it
the same run with `--scheduler serial`: what its process holds then, it holds for plan, journal and tables. CPU
milliseconds a cell are of the cells' own stages too (workers).
"""

from __future__ import annotations

import argparse
import os
import resource
import subprocess
import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent / "faults"))
from cluster import Cluster, Place, children, cluster

TICK = os.sysconf("SC_CLK_TCK")


def peak(pid: int) -> float:
    """The most memory a process has held, MB."""
    lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    return int(next(line for line in lines if line.startswith("VmHWM")).split()[1]) * 1024 / 1e6


def processor(pid: int) -> float:
    """Processor seconds of a process."""
    fields = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / TICK


def measured(place: Place, cells: int, archive: str, *words: str) -> tuple[float, float]:
    """Peak MB and processor seconds of the process of a run."""
    hows = tuple(str(n) for n in range(1, cells // 2 + 1))
    (place.folder / "many.toml").write_text(MANY.replace("HOWS", ", ".join(f'"{how}"' for how in hows)))
    command = [sys.executable, "-m", "etendue", "run", "many.toml", "--json", "--quiet", "--archive", archive, *words]
    process = subprocess.Popen(command, cwd=place.folder, env=place.env, stdout=subprocess.DEVNULL)
    _, status, used = os.wait4(process.pid, 0)
    assert os.waitstatus_to_exitcode(status) == 0
    return used.ru_maxrss * 1024 / 1e6, used.ru_utime + used.ru_stime


MANY = """
name = "many"
precision = "float32"
[[stages]]
use = "lamp"
[[stages]]
use = "toil"
pause = 0
[[stages]]
use = "witness"
pause = 0
[sweep]
"toil.how" = [HOWS]
"""


def row(place: Place, there: Cluster, cells: int) -> str:
    serial, serial_seconds = measured(place, cells, f"serial{cells}", "--scheduler", "serial")
    workers = [pid for worker in there.workers for pid in children(worker.pid)]
    before, working = processor(there.scheduler.pid), sum(map(processor, workers))
    client, seconds = measured(place, cells, f"cluster{cells}", "--scheduler", there.address)
    each = 1e3 / cells
    scheduling, worked = processor(there.scheduler.pid) - before, sum(map(processor, workers)) - working
    return (
        f"{cells:7d} | {serial:8.0f} {client:8.0f} {client - serial:+8.0f} | {peak(there.scheduler.pid):9.0f} | "
        f"{serial_seconds * each:7.2f} {seconds * each:7.2f} {scheduling * each:9.2f} {worked * each:8.2f}"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("cells", type=int, nargs="*", default=[1000, 10000, 30000])
    given = parser.parse_args()
    resource.setrlimit(resource.RLIMIT_NOFILE, (resource.getrlimit(resource.RLIMIT_NOFILE)[1],) * 2)
    print("        | peak MB of the client      | peak MB   | CPU ms a cell")
    print("  cells |   serial  cluster   more   | scheduler |  serial  client scheduler  workers")
    for cells in given.cells:
        with tempfile.TemporaryDirectory() as folder:
            place = Place(Path(folder))
            with cluster(place) as there:
                print(row(place, there, cells), flush=True)


if __name__ == "__main__":
    main()
