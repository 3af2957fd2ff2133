"""What an evaluation of pipelines/sweep.toml costs where only one parameter changes, each time to another value, and
what simulate in a loop costs: the median of wall and CPU milliseconds; memory after many evaluations; bits in threads.

    python benchmarks/sessions.py [--repeats N] [--evaluations N]

``own``: CPU milliseconds of the stages that an evaluation computes, from their own reports.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import resource
import statistics
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import etendue
from etendue.evaluation.evaluating import evaluate
from etendue.evaluation.session import Session

SWEEP = Path(__file__).resolve().parent.parent / "pipelines" / "sweep.toml"
POINT = {"f_number": 2.8, "pixel_pitch": "3 um", "integration_time": "10 ms"}
CASES: dict[str, tuple[tuple[str, ...], Callable[[int], dict[str, Any]]]] = {
    "mean_snr and gamut_clipped after read_noise": (
        ("mean_snr", "gamut_clipped"),
        lambda n: {"read_noise": 3 + n / 1000},
    ),
    "rgb_display after the exponent of encode": (("rgb_display",), lambda n: {"encode__exponent": 2 + n / 1000}),
    "MTF50 after f_number": (("mtf50",), lambda n: {"f_number": 2 + n / 1000}),
    "mean_snr after integration_time": (("mean_snr",), lambda n: {"integration_time": f"{4 + n / 1000} ms"}),
}


def resident() -> int:
    """Bytes of this process in memory."""
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * resource.getpagesize()


def own_seconds(session: Session, names: tuple[str, ...], values: dict[str, Any]) -> float:
    plan = session.plan(names, values)
    wanted = {cell.ref: frozenset({variable}) for stage, variable in plan.wanted for cell in plan.of(stage)}
    return sum(report.seconds for report in evaluate(plan, wanted, session.results).computed)


def timed(ask: Callable[[int], Any], repeats: int) -> tuple[float, float]:
    """The median of wall and CPU milliseconds; ``ask`` gets another number each time."""
    walls, cpus = [], []
    for n in range(repeats):
        wall, cpu = time.perf_counter(), time.process_time()
        ask(n)
        walls.append(1e3 * (time.perf_counter() - wall))
        cpus.append(1e3 * (time.process_time() - cpu))
    return statistics.median(walls), statistics.median(cpus)


def digest(record: dict[str, Any]) -> str:
    found = hashlib.sha256()
    for name, value in record.items():
        found.update(name.encode())
        found.update(value.tobytes() if hasattr(value, "tobytes") else float(value).hex().encode())
    return found.hexdigest()


def main() -> None:
    given = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    given.add_argument("--repeats", type=int, default=30)
    given.add_argument("--evaluations", type=int, default=2000)
    asked = given.parse_args()
    print(f"load {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores")
    pipeline = etendue.Pipeline.read(SWEEP)
    session = pipeline.session()
    print(f"{'':48} wall ms   CPU ms   own ms")
    for title, (names, change) in CASES.items():
        session.metrics(names, **{**POINT, **change(-1)})
        wall, cpu = timed(
            lambda n, names=names, change=change: session.metrics(names, **{**POINT, **change(n)}), asked.repeats
        )
        own = 1e3 * statistics.median(
            own_seconds(session, names, {**POINT, **change(500 + n)}) for n in range(asked.repeats)
        )
        print(f"{title:48} {wall:7.1f}  {cpu:7.1f}  {own:7.1f}")
    repeats = max(3, asked.repeats // 6)
    for title, ask in (
        ("a tree of the session after read_noise", lambda n: session(**POINT, read_noise=5 + n / 1000)),
        ("simulate in a loop, after read_noise", lambda n: loop(read_noise=5 + n / 1000)),
        ("simulate without memory, after read_noise", lambda n: loop(read_noise=6 + n / 1000, scheduler="serial")),
    ):
        ask(-1)
        wall, cpu = timed(ask, repeats)
        print(f"{title:48} {wall:7.1f}  {cpu:7.1f}")
    session = pipeline.session(bytes=64 << 20)
    names, change = CASES["mean_snr and gamut_clipped after read_noise"]
    early = 0
    for n in range(asked.evaluations):
        session.metrics(names, **{**POINT, **change(n)})
        early = resident() if n == 99 else early
    print(
        f"memory after {asked.evaluations} evaluations: {resident() / 1e6:.0f} MB, after 100: {early / 1e6:.0f} MB, "
        f"ratio {resident() / early:.3f}; kept {session.bytes / 1e6:.0f} of {session.results.most / 1e6:.0f} MB"
    )
    every = [(names, {**POINT, **change(n)}) for n in range(4) for names, change in CASES.values()]
    alone = [digest(pipeline.session().metrics(names, **values)) for names, values in every[:4]]
    one = [digest(session.metrics(names, **values)) for names, values in every]
    with ThreadPoolExecutor(8) as pool:
        many = list(pool.map(lambda one: digest(session.metrics(one[0], **one[1])), every * 4))
    print(f"eight threads: {'the same bits' if many == one * 4 and alone == one[:4] else 'OTHER BITS'}")


def loop(**values: Any) -> Any:
    return etendue.simulate(SWEEP, errors=False, **{"read_noise": 4, **POINT, **values})


if __name__ == "__main__":
    main()
