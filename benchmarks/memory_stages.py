"""What every installed stage works with on a frame of 2 Mpixel, beside what it says (``Stage.working``):
``memory.py stages``.

In:  names of stages, or none for all; precisions.
Out: a row of each: bytes that are resident while it computes, what a plan counts for it, and the ``working`` that would
     be right.

Every stage stands as its defaults and examples make it. What another distribution's is handed is counted beside what it
says.
"""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

FRAME = (1152, 1536)
SMALL = (27, 36)
LARGEST = 1.3


def waves(frame: tuple[int, int]) -> Any:
    """A picture in which no pixel stands out of its neighbours."""
    y, x = np.ogrid[: frame[0], : frame[1]]
    return 0.5 + 0.4 * np.sin(y / 19) * np.sin(x / 23)


def rows_of(names: Sequence[str]) -> list[str]:
    """Installed stages that read or write frames and are no transfer functions, which the engine computes."""
    from etendue.contract.capabilities import is_transfer
    from etendue.contract.registry import installed_stages
    from etendue.contract.stage import reads_of, writes_of

    found, stages = [], installed_stages()
    for name in stages.names():
        kind = stages.load(name)
        dims = {dim for d in (*reads_of(kind).values(), *writes_of(kind).values()) for dim in d.dims}
        if (not names or name in names) and {"y", "x"} <= dims and not is_transfer(kind):
            found.append(name)
    return found


def row(name: str, precision: str, **given: Any) -> dict[str, float]:
    """Bytes of one stage: all that it reads, what comes to it, what is planned to, and ``working``: what is right
    and what it says.
    """
    from etendue.compute.cell import compute
    from etendue.compute.joined.segments import Result
    from etendue.compute.tables import TABLES
    from etendue.contract.capabilities import is_source
    from etendue.contract.registry import installed_stages
    from etendue.contract.stage import looks_at_stages
    from etendue.run.peak_memory import job_bytes
    from etendue.testing.bench import Bench
    from etendue.testing.cases import ordinary

    kind = installed_stages().load(name)
    values = ordinary(kind) | given

    def bench_of(frame: tuple[int, int]) -> Bench:
        own = {"spacing": 2.0, "width": 2.0 * frame[1], "height": 2.0 * frame[0]} if is_source(kind) else {}
        return Bench(kind(**values | {name: value for name, value in own.items() if name in values}))

    def once(frame: tuple[int, int]) -> tuple[float, float, float, Any]:
        bench = bench_of(frame)
        job, results = bench.job(precision, frame), {}
        for port, declared in bench.reads.items():
            dtype = precision if declared.dtype == "float" else declared.dtype
            shape = bench.input_grids(frame)[port].shape(declared.dims)
            own = bench.scale(port) * waves(frame) if shape[-2:] == frame else bench.array(port, "ordinary", frame)
            array = np.array(np.broadcast_to(own, shape), dtype, order="C")
            array.flags.writeable = False
            results[port, ()] = Result({declared.variable: array})
        for number, looked in enumerate(("first", "second"), 1):
            seen = {
                what: bench.seen(port, precision, frame)
                for port, what in bench.looks.items()
                if not looks_at_stages(what)
            }
            results[looked, ()] = Result({what: (array / number).astype(array.dtype) for what, array in seen.items()})
        base = _resident("VmRSS")
        Path("/proc/self/clear_refs").write_text("5")
        result, report = compute(job, results)
        peak = _resident("VmHWM") - base
        made = sum(array.nbytes for array in result.arrays.values())
        read = sum(array.nbytes for one in results.values() for array in one.arrays.values())
        if report.status != "done":
            raise ValueError(report.message.strip().rpartition("\n")[2])
        return peak, made, read, job

    once(SMALL)
    TABLES.clear()
    peak, made, read, job = once(FRAME)
    planned, largest = job_bytes(job, precision)
    return {"peak": peak, "read": read, "planned": planned, "right": (peak - made) / largest, "says": kind.working}


def _resident(name: str) -> int:
    line = next(line for line in Path("/proc/self/status").read_text().splitlines() if line.startswith(name + ":"))
    return 1024 * int(line.split()[1])


def main(names: Sequence[str], precisions: Sequence[str]) -> int:
    ctypes.CDLL(None).mallopt(-3, 1 << 16)  # M_MMAP_THRESHOLD: what is freed is given back, what is resident is held
    worst = 1.0
    print(f"{'stage':28s} precision  measured   planned  ratio   says  would be right")
    for name in rows_of(names):
        for precision in precisions:
            head = f"{name:28s} {precision:9s}"
            try:
                found = row(name, precision)
            except Exception as error:  # files that a stage wants, optional libraries
                print(f"{head} not run: {str(error).splitlines()[0][:100]}", flush=True)
                continue
            held, expected = found["read"] + found["peak"], found["read"] + found["planned"]
            ratio = expected / held if held else 1.0
            worst = max(worst, ratio, 1 / ratio)
            sizes = f"{held / 1e6:6.0f} MB {expected / 1e6:6.0f} MB {ratio:6.2f}"
            beyond = "" if 1 / LARGEST <= ratio <= LARGEST else "  *"
            print(f"{head} {sizes} {found['says']:6.1f} {found['right']:6.2f}{beyond}", flush=True)
    print(f"worst: {worst:.2f} times, either way")
    return 0
