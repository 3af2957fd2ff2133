"""Many runs in one process: at once, and one after the other.

    python benchmarks/many_runs.py threads [--threads 8] [--rounds 50] [--only memory,archives] [--times 1]
    python benchmarks/many_runs.py memory [--runs 2000] [--size 32]

threads: every thread runs a camera of its own, round by round; what it gives is held against what the same run gives
alone, by the digest of every array. Out: how many of all are wrong, by what the runs were. Exit code 1 if any is.

memory: one small camera after the other, nothing of them held. Out: what the process holds resident after so many.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import ctypes
import gc
import hashlib
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from etendue.api import Stage, hookimpl, quantity
from etendue.builder.simulating import simulate
from etendue.contract.registry import Registry, installed_stages
from etendue.plan.planner import make_plan
from etendue.plugins.discovery import Discovery, installed
from etendue.session import Options, collect, execute, load

MEASURED = ("ledger", "summary")  # tables that hold run times
CAMERA = """
name = "small"
seed = 3
tolerance = 1e-4

[camera]
peak_qe = [0.36, 0.44, 0.40]
pixel_pitch = "2.6 um"

[[stages]]
use = "composite"
name = "scene"
white_luminance = "1000 cd m-2"
width = "96 um"
height = "96 um"
spacing = "2 um"
wavelength_from = "400 nm"
wavelength_to = "700 nm"
bin_width = "100 nm"

[[stages]]
use = "irradiance"
[[stages]]
use = "diffraction"
[[stages]]
use = "pixel"
rows = 32
columns = 32
[[stages]]
use = "mosaic"
[[stages]]
use = "exposure"
[[stages]]
use = "shot_noise"
[[stages]]
use = "adc"
[[stages]]
use = "linearise"
[[stages]]
use = "demosaic_bilinear"
name = "demosaic"
[[stages]]
use = "sharpen"
[[stages]]
use = "resolution"
"""
OTHER = (
    CAMERA.replace('"composite"', '"slanted_edge"')
    .replace("seed = 3", 'seed = 4\nprecision = "float64"')
    .replace("bilinear", "nearest")
)
FAILING = CAMERA.replace('[[stages]]\nuse = "exposure"', '[[stages]]\nuse = "breaks"\n[[stages]]\nuse = "exposure"')


@dataclass(frozen=True, kw_only=True)
class Breaks(Stage):
    """Breaks off, and leaves the process changed."""

    reads: ClassVar = {"photocurrent": "y x [electron/s]"}
    writes: ClassVar = {"photocurrent": "y x [electron/s]"}
    f_number: float = quantity("f_number")

    def run(self, photocurrent: Any) -> Any:
        import os
        import warnings

        os.chdir("/")
        warnings.simplefilter("ignore")
        np.seterr(all="raise")
        time.sleep(0.002)  # others go on meanwhile
        raise ArithmeticError("told to")


@hookimpl
def etendue_stages() -> dict[str, type]:
    return {"breaks": Breaks}


def registry() -> Registry:
    return Registry(Discovery([*installed().points, EntryPoint("own", __name__, "etendue")]))


# -- what one thread does in one round ------------------------------------------------------------------------------


@dataclass
class Place:
    """Where a run is: its thread and round, which choose its camera; a folder for its archive; the stages that there
    are.
    """

    thread: int
    round: int
    folder: Path
    registry: Registry = field(default_factory=installed_stages)

    @property
    def time(self) -> str:
        return f"{2 + self.thread} ms"


def digest(arrays: dict[str, Any]) -> str:
    found = hashlib.blake2b(digest_size=16)
    for name in sorted(arrays):
        array = np.asarray(arrays[name])
        found.update(f"{name} {array.dtype} {array.shape}".encode())
        found.update(repr(array.tolist()).encode() if array.dtype.kind in "OTU" else array.tobytes())
    return found.hexdigest()


def of_tree(tree: Any) -> str:
    """Everything in a tree but run times."""
    nodes = [node for node in tree.subtree if node.path.strip("/").partition("/")[0] not in MEASURED]
    return digest({f"{node.path}/{name}": array for node in nodes for name, array in node.dataset.variables.items()})


def memory(place: Place, **how: Any) -> str:
    return of_tree(simulate(CAMERA, integration_time=place.time, **how))


def serial(place: Place, **_: Any) -> str:
    return memory(place, scheduler="serial")


def pipelines(place: Place, **how: Any) -> str:
    """Two in turns, with the same names of stages."""
    return of_tree(simulate(CAMERA if place.thread % 2 else OTHER, f_number=2 + place.thread, **how))


def archives(place: Place, **how: Any) -> str:
    folder = place.folder / f"{place.thread}-{place.round}-{threading.get_ident()}"
    with simulate(CAMERA, archive=folder, integration_time=place.time, **how) as tree:
        return of_tree(tree)


def collected(place: Place, scheduler: str = "threads") -> str:
    """Plans, and some arrays of them: what studies do."""
    plan = make_plan(load(CAMERA, {"camera.integration_time": place.time}), place.registry)
    wanted = {
        ref: tuple(plan.node(ref[0]).writes) for ref in plan.cells if ref[0] in ("pixel", "sharpen", "resolution")
    }
    found = collect(plan, wanted, Options(scheduler))
    return digest({f"{ref} {name}": array for ref, own in found.arrays.items() for name, array in own.items()})


def plots(place: Place, **how: Any) -> str:
    """A run, and what is drawn of it."""
    tree = simulate(CAMERA, f_number=[2, 2.8, 4 + place.thread], want=["rgb_camera", "resolution.mtf50"], **how)
    drawn = tree.etendue.plot.curves("mtf50").data("png") + tree.etendue.show("rgb_camera", f_number=2.8).data("png")
    return of_tree(tree) + hashlib.blake2b(drawn, digest_size=16).hexdigest()


def raising(place: Place, **how: Any) -> str:
    """Every other run breaks off: in a stage, or in what it tells of itself."""
    plan = make_plan(load(FAILING, {"camera.integration_time": place.time}), place.registry)
    outcome = execute(plan, options=Options(**how))
    failed = sorted(f"{report.stage} {report.message.splitlines()[-1]}" for report in outcome.failed)
    with contextlib.suppress(ZeroDivisionError):
        execute(make_plan(load(CAMERA), place.registry), options=Options(**how), progress=Told(lambda: 1 // 0))
        failed.append("not told")
    return memory(place, **how) + " ".join(failed)


def interrupted(place: Place, **how: Any) -> str:
    """Every other run is interrupted, as a notebook interrupts what it runs."""
    mine = ctypes.c_ulong(threading.get_ident())

    def interrupt() -> None:
        ctypes.pythonapi.PyThreadState_SetAsyncExc(mine, ctypes.py_object(KeyboardInterrupt))

    said = "went on"
    try:
        execute(make_plan(load(CAMERA), place.registry), options=Options(**how), progress=Told(interrupt))
        time.sleep(0.01)  # where it came at the very end
    except KeyboardInterrupt:
        said = "interrupted"
    return memory(place, **how) + said


class Told:
    """Progress of a run that is disturbed at its second batch."""

    def __init__(self, what: Callable[[], Any]) -> None:
        self.what, self.count = what, 0

    def begin(self, cells: int) -> None: ...

    def starting(self, stages: tuple[str, ...]) -> None: ...

    def finished(self, reports: Any) -> None:
        self.count += 1
        if self.count == 1:
            self.what()

    def end(self) -> None: ...


KINDS: dict[str, Callable[..., str]] = {
    "memory": memory,
    "serial": serial,
    "pipelines": pipelines,
    "archives": archives,
    "collected": collected,
    "plots": plots,
    "raising": raising,
    "interrupted": interrupted,
}


# -- many at once ---------------------------------------------------------------------------------------------------


@dataclass
class Trial:
    """``kinds``: what each thread does, in turns. ``wrong`` counts by kind, ``said`` holds the first words on each."""

    kinds: tuple[str, ...]
    threads: int = 8
    rounds: int = 10
    folder: Path = Path()
    done: Counter[str] = field(default_factory=Counter)
    wrong: Counter[str] = field(default_factory=Counter)
    said: dict[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.registry = registry()
        self.alone = {number: self.once(number, -1, scheduler="serial") for number in range(self.threads)}

    def once(self, number: int, round_: int, **how: Any) -> str:
        return KINDS[self.kind(number)](Place(number, round_, self.folder, self.registry), **how)

    def kind(self, number: int) -> str:
        return self.kinds[number % len(self.kinds)]

    def judged(self, number: int, round_: int) -> None:
        kind = self.kind(number)
        try:
            found = self.once(number, round_)
            text = "" if found == self.alone[number] else "another digest"
        except BaseException as error:  # whatever comes counts
            text = f"{type(error).__name__}: {error}"[:200]
        self.done[kind] += 1
        if text:
            self.wrong[kind] += 1
            self.said.setdefault(kind, text)

    def run(self) -> None:
        """In threads, that begin together."""
        together = threading.Barrier(self.threads)

        def rounds(number: int) -> None:
            together.wait()
            for round_ in range(self.rounds):
                self.judged(number, round_)

        with ThreadPoolExecutor(self.threads) as pool:
            list(pool.map(rounds, range(self.threads)))

    def run_with_asyncio(self) -> None:
        """As a web server does: ``asyncio.to_thread``."""

        async def every() -> None:
            for round_ in range(self.rounds):
                await asyncio.gather(
                    *(asyncio.to_thread(self.judged, number, round_) for number in range(self.threads))
                )

        asyncio.run(every())

    def run_in_a_dask_worker(self, threads: int = 4) -> None:
        import dask
        import distributed

        with (
            # What Dask's profiler asks every 10 ms may hang CPython 3.11 where others start threads (its issue 106883).
            dask.config.set({"distributed.worker.profile.enabled": sys.version_info >= (3, 12)}),
            distributed.LocalCluster(
                n_workers=1, threads_per_worker=threads, processes=False, dashboard_address=None
            ) as cluster,
            distributed.Client(cluster, set_as_default=False) as client,
        ):
            TRIALS[id(self)] = self
            places = [(number, round_) for round_ in range(self.rounds) for number in range(self.threads)]
            client.gather([client.submit(judged_by, id(self), *place, pure=False) for place in places])
            del TRIALS[id(self)]


TRIALS: dict[int, Trial] = {}  # that are under way; the worker is in this process


def judged_by(trial: int, number: int, round_: int) -> None:
    TRIALS[trial].judged(number, round_)


@contextlib.contextmanager
def process_unchanged() -> Iterator[list[str]]:
    """What of the process is another behind it.

    Of equal filters the first alone says anything: libraries that set one in several threads leave it there twice.
    """
    import os
    import warnings

    from threadpoolctl import threadpool_info

    def state() -> dict[str, Any]:
        pools = {pool["filepath"]: pool["num_threads"] for pool in threadpool_info()}
        return {
            "working folder": os.getcwd(),
            "filters of warnings": list(dict.fromkeys(warnings.filters)),
            "collector": (gc.isenabled(), gc.get_threshold()),
            "frozen objects": gc.get_freeze_count(),
            "errors of numpy": np.geterr(),
            "threads of BLAS": pools,
        }

    before, changed = state(), []  # type: dict[str, Any], list[str]
    yield changed
    after = state()
    new = after["threads of BLAS"].keys() - before["threads of BLAS"].keys()
    for pool in new:
        del after["threads of BLAS"][pool]
    changed += [f"{name}: {before[name]} -> {after[name]}" for name in before if before[name] != after[name]]


WAYS = {"threads": Trial.run, "asyncio": Trial.run_with_asyncio, "dask worker": Trial.run_in_a_dask_worker}


def trials(threads: int, rounds: int, only: tuple[str, ...] = ()) -> Iterator[tuple[str, Trial, list[str]]]:
    """Every kind by itself in threads, all together in every way; with what is changed in the process behind it."""
    plan = [(kind, (kind,), "threads") for kind in KINDS] + [(f"all, {way}", tuple(KINDS), way) for way in WAYS]
    plan += [(f"memory, {way}", ("memory",), way) for way in WAYS if way != "threads"]
    for name, kinds, way in plan:
        if not only or name in only:
            with tempfile.TemporaryDirectory() as folder:
                trial = Trial(kinds, threads, rounds, Path(folder))
                with process_unchanged() as changed:
                    WAYS[way](trial)
            yield name, trial, changed


def threads_main(given: argparse.Namespace) -> int:
    whole = Counter[str]()
    print(f"{'runs':22} {'wrong':>6} {'of':>6} {'seconds':>8}", flush=True)
    for _ in range(given.times):
        began = time.perf_counter()
        for name, trial, changed in trials(given.threads, given.rounds, given.only):
            wrong, done = trial.wrong.total(), trial.done.total()
            print(f"{name:22} {wrong:6} {done:6} {time.perf_counter() - began:8.1f}", flush=True)
            for kind, text in trial.said.items():
                print(f"    {kind}: {text}", flush=True)
            for text in changed:
                print(f"    left behind: {text}", flush=True)
            whole.update(wrong=wrong + bool(changed), done=done)
            began = time.perf_counter()
    print(f"{'all':22} {whole['wrong']:6} {whole['done']:6}")
    return bool(whole["wrong"])


# -- one after the other --------------------------------------------------------------------------------------------


def resident() -> float:
    """MB."""
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith("VmRSS:"):
            return int(line.split()[1]) / 1024
    return float("nan")


def curve(
    runs: int, size: int = 32, looks: tuple[int, ...] = (20, 50, 100, 200, 500, 1000, 1500, 2000)
) -> list[tuple[int, float]]:
    """(runs, MB) after so many of them, at f-numbers that all differ."""
    text, found = CAMERA.replace("rows = 32", f"rows = {size}").replace("columns = 32", f"columns = {size}"), []
    text = text.replace("96 um", f"{3 * size} um")
    for number in range(1, runs + 1):
        simulate(text, f_number=round(2 + number / 1000, 3))
        if number in looks or number == runs:
            found.append((number, resident()))
    return found


def memory_main(given: argparse.Namespace) -> int:
    from etendue.evaluation.remembering import MEMORY

    MEMORY.clear(0)  # what a loop keeps on purpose, up to 256 MiB, would hide a leak
    print(f"{'runs':>6} {'MB':>8}")
    began = time.process_time()
    for number, megabytes in curve(given.runs, given.size):
        print(f"{number:6} {megabytes:8.1f}", flush=True)
    print(f"{(time.process_time() - began) / given.runs * 1e3:.1f} ms of CPU a run")
    return 0


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    kinds = parser.add_subparsers(required=True)
    threads = kinds.add_parser("threads")
    threads.add_argument("--threads", type=int, default=8)
    threads.add_argument("--rounds", type=int, default=50)
    threads.add_argument("--times", type=int, default=1)
    threads.add_argument("--only", type=lambda text: tuple(text.split(";")), default=(), metavar="NAME;NAME")
    threads.set_defaults(do=threads_main)
    small = kinds.add_parser("memory")
    small.add_argument("--runs", type=int, default=2000)
    small.add_argument("--size", type=int, default=32, help="pixels of a side")
    small.set_defaults(do=memory_main)
    given = parser.parse_args()
    done: int = given.do(given)
    return done


if __name__ == "__main__":
    import many_runs  # what travels to a worker is found there by the name of its module

    sys.exit(many_runs.main())
