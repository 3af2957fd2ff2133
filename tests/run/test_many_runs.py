"""Runs at once in one process: each gives what it gives alone, whatever the others do and whichever way they came to be
at once.

``benchmarks/many_runs.py`` has the cameras and what threads do with them; there, in longer turns, the same is counted.
"""

from __future__ import annotations

import gc
import importlib.util
import json
import subprocess
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from threadpoolctl import ThreadpoolController, threadpool_info

import etendue
from etendue.archive.checks.verify import verify
from etendue.errors import ArchiveInUse
from etendue.run.one_thread import ONE_THREAD
from tests.run.small import environment

PROGRAM = Path(__file__).parents[2] / "benchmarks" / "many_runs.py"
FAST = (
    "memory",
    "collected",
    "pipelines",
    "collected",
    "collected",
    "pipelines",
    "collected",
    "collected",
)  # what each thread does
BESIDE = ("raising", "memory", "interrupted", "collected")  # two that break off, beside others
LONG = {
    "memory": ("threads", ("memory",)),
    "archives": ("threads", ("archives",)),
    "two pipelines": ("threads", ("pipelines", "serial", "pipelines", "collected")),
    "some raise": ("threads", BESIDE),
    "asyncio": ("asyncio", ("memory", "pipelines")),
    "Dask worker": ("dask worker", BESIDE),
}


@pytest.fixture(scope="module")
def many_runs():
    """The module of the benchmark, under the name by which a worker finds it."""
    spec = importlib.util.spec_from_file_location("many_runs", PROGRAM)
    module = importlib.util.module_from_spec(spec)
    sys.modules["many_runs"] = module
    spec.loader.exec_module(module)
    gc.unfreeze()  # of the tests: runs freeze nothing
    yield module
    gc.collect()
    gc.freeze()
    del sys.modules["many_runs"]


def right(many_runs, folder, way, kinds, rounds, threads=8):
    """So many threads, so many rounds: every digest is that of the same run alone, and the process is as it was
    before.
    """
    if way == "dask worker":
        pytest.importorskip("distributed")
    trial = many_runs.Trial(kinds, threads, rounds, folder)
    with many_runs.process_unchanged() as changed:
        many_runs.WAYS[way](trial)
    assert trial.done.total() == threads * rounds
    assert not trial.wrong, (trial.wrong, trial.said)
    assert not changed


def test_runs_at_once_in_threads_are_those_of_each_alone(many_runs, tmp_path):
    right(many_runs, tmp_path, "threads", FAST, rounds=10)


def test_so_are_those_beside_some_that_raise_and_are_interrupted(many_runs, tmp_path):
    right(many_runs, tmp_path, "threads", BESIDE, rounds=3, threads=4)


@pytest.mark.parametrize("way", ["asyncio", "dask worker"])
def test_so_are_those_of_others_that_have_threads(many_runs, tmp_path, way):
    right(many_runs, tmp_path, way, ("memory", "collected"), rounds=2, threads=4)


def test_so_are_those_with_archives_of_their_own(many_runs, tmp_path):
    right(many_runs, tmp_path, "threads", ("archives",), rounds=1, threads=4)


@pytest.mark.long
@pytest.mark.timeout(3600)
@pytest.mark.parametrize(("way", "kinds"), LONG.values(), ids=LONG)
def test_so_are_fifty_rounds_of_each_in_eight_threads(many_runs, tmp_path, way, kinds):
    right(many_runs, tmp_path, way, kinds, rounds=50)


def test_blas_has_one_thread_whichever_thread_begins_and_ends_the_runs():
    """Also where another has asked ``threadpoolctl`` for a number of its own, and where runs end in another order
    than they began.
    """

    def threads():
        return {pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"}

    def elsewhere(work):
        with ThreadPoolExecutor(1) as pool:
            return pool.submit(work).result()

    def whole():
        with ONE_THREAD:
            return threads()

    controller = ThreadpoolController()
    for library in controller.lib_controllers:  # whichever thread has asked before, in another law
        getattr(library, "clear_controlling_thread", lambda force: None)(force=True)
    own = controller.limit(limits=2)
    assert not ONE_THREAD.count  # no run or worker that has ended holds libraries, whatever ran here before
    try:
        assert [whole(), threads(), elsewhere(whole), threads()] == [{1}, {2}, {1}, {2}]
        elsewhere(ONE_THREAD.__enter__)
        ONE_THREAD.__enter__()
        elsewhere(ONE_THREAD.__exit__)
        assert threads() == {1}
        ONE_THREAD.__exit__()
        assert threads() == {2}
        ONE_THREAD.__enter__()
        elsewhere(ONE_THREAD.__exit__)
        assert threads() == {2}
    finally:
        own.restore_original_limits()


LATER = """
from threadpoolctl import threadpool_info

import numpy
from etendue.run.one_thread import ONE_THREAD


def threads():
    return {pool["filepath"]: pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"}


with ONE_THREAD:
    first = threads()
import scipy.linalg

before = threads()
with ONE_THREAD:
    second = threads()
print(len(first) < len(second), set(first.values()), set(second.values()), threads() == before)
"""


def test_a_library_that_was_loaded_between_two_runs_has_one_thread_too():
    """Where numpy and scipy bring one each."""
    done = subprocess.run(
        [sys.executable, "-c", LATER],
        env=environment(OPENBLAS_NUM_THREADS="2"),
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    more, *_ = said = done.stdout.split(" ", 1)
    if more == "False":
        pytest.skip("numpy and scipy share a library")
    assert said == ["True", "{1} {1} True\n"], done.stderr


COLD = """
import os, signal, sys, threading, time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import many_runs
from etendue.session import execute, load
from etendue.plan.planner import make_plan

signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's job in the background is started to ignore it
together = threading.Barrier(5)


def first(number):
    together.wait()
    return many_runs.KINDS[("memory", "pipelines")[number % 2]](many_runs.Place(number, 0, Path()))


with ThreadPoolExecutor(4) as pool:
    asked = [pool.submit(first, number) for number in range(4)]
    together.wait()
    ctrl_c = many_runs.Told(lambda: os.kill(os.getpid(), signal.SIGINT))
    try:
        execute(make_plan(load(many_runs.CAMERA), many_runs.registry()), progress=ctrl_c)
        print("went on")
    except KeyboardInterrupt:
        print("interrupted")
    found = [one.result() for one in asked]
together = threading.Barrier(1)
print(["other"[: 5 * (one != first(number))] for number, one in enumerate(found)])
"""


def test_so_are_the_first_of_a_process_beside_one_that_ctrl_c_ends(many_runs):
    """Nothing is imported or remembered yet: threads plan, import and run together. Ctrl-C is the main thread's
    run's alone.
    """
    done = subprocess.run(
        [sys.executable, "-c", COLD],
        env=environment(PYTHONPATH=str(PROGRAM.parent)),
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert done.stdout.splitlines() == ["interrupted", "['', '', '', '']"], done.stderr


def test_of_those_that_want_one_archive_one_has_it_and_the_others_are_told(many_runs, tmp_path):
    together = threading.Barrier(4)
    place = many_runs.Place(0, 0, tmp_path)

    def run(number):
        together.wait()
        try:
            with etendue.simulate(many_runs.CAMERA, archive=tmp_path / "a", integration_time=place.time) as tree:
                return many_runs.of_tree(tree)
        except ArchiveInUse:
            return "in use"

    alone = many_runs.archives(place)
    with ThreadPoolExecutor(4) as pool:
        found = list(pool.map(run, range(4)))
    assert alone in found
    assert set(found) <= {alone, "in use"}
    assert verify(tmp_path / "a").whole


@pytest.mark.long
@pytest.mark.timeout(3600)
def test_so_are_those_that_have_processes_of_their_own(many_runs, tmp_path):
    """``Pipeline.run`` with workers, in threads of a script."""
    script = tmp_path / "script.py"
    script.write_text(
        "import json, threading\nfrom concurrent.futures import ThreadPoolExecutor\nimport etendue, many_runs\n\n"
        "def run(number, **how):\n"
        "    camera = etendue.Pipeline.read('camera.toml').camera(integration_time=f'{2 + number} ms')\n"
        "    return many_runs.of_tree(camera.run(progress=False, **how).tree)\n\n"
        "if __name__ == '__main__':\n"
        "    with ThreadPoolExecutor(3) as pool:\n"
        "        found = list(pool.map(lambda number: run(number, scheduler='processes', workers=2), [0, 1, 2]))\n"
        "    print(json.dumps([found, [run(number, scheduler='serial') for number in range(3)]]))\n"
    )
    (tmp_path / "camera.toml").write_text(many_runs.CAMERA)
    done = subprocess.run(
        [sys.executable, script],
        cwd=tmp_path,
        env=environment(PYTHONPATH=str(PROGRAM.parent)),
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    found, alone = json.loads(done.stdout)
    assert found == alone
