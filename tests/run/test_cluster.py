"""A cluster gets few batches at a time and gives the bits of a serial run; deaths, strangers and lost schedulers end in
words.

What needs no processes is tried on a client that computes in this process; the rest by
``benchmarks/faults/cluster.py``.
"""

from __future__ import annotations

import importlib.util
import itertools
import pickle
import random
import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import pytest

from etendue.archive.records.provenance import platform_record
from etendue.compute.jobs import make_jobs
from etendue.errors import MachineError
from etendue.run.batches import partition
from etendue.run.cluster import connect, watching
from etendue.run.cluster.alike import common_of
from etendue.run.cluster.sending import AHEAD, Sending
from etendue.run.schedulers import How
from etendue.run.watch import Stop, Stopped
from tests.run.small import SWEEP, assert_same_arrays, plan_of, run
from tests.run.small import by_labels as labelled

DRIVER = Path(__file__).parents[2] / "benchmarks" / "faults" / "cluster.py"
WORKERS = 2


class KilledWorker(Exception):
    """By its name, as Dask's own."""


class Future:
    """A task of ``Client``; released when nobody holds it."""

    def __init__(self, key, task):
        self.key, self.task = key, task

    @property
    def status(self):
        return "pending" if not self.task.done() else "error" if self.task.exception() else "finished"

    def exception(self):
        return self.task.exception()

    def result(self):
        return self.task.result()

    def add_done_callback(self, tell):
        self.task.add_done_callback(lambda _: tell(self))


class Client:
    """What ``Sending`` asks of a Dask client, in two threads of this process. Workers die of the cell ``guilty``."""

    def __init__(self, guilty=None):
        self.pool, self.status, self.guilty = ThreadPoolExecutor(WORKERS), "running", guilty
        self.numbers = itertools.count()
        self.workers = {
            f"tcp://{n}": {"nthreads": 1, "memory_limit": 1 << 30, "status": "running"} for n in range(WORKERS)
        }

    def submit(self, function, *arguments, pure, priority=0):
        tasks = [a.task if isinstance(a, Future) else a for a in arguments]
        given = [t for t, a in zip(tasks, arguments, strict=True) if isinstance(a, Future)]

        def work():
            for data in arguments:
                if isinstance(data, bytes):
                    jobs, _, _, _, doomed, *_ = pickle.loads(data)
                    if self.guilty not in doomed and any(job.ref == self.guilty for job in jobs):
                        raise KilledWorker
            return function(*(t.result() if t in given else t for t in tasks))

        return Future(next(self.numbers), self.pool.submit(work))

    def gather(self, futures):
        return [future.result() for future in futures]

    def scheduler_info(self, n_workers):
        return {"workers": self.workers}

    def processing(self):
        return {}

    def cancel(self, futures):
        pass

    def subscribe_topic(self, topic, handler):
        pass

    unsubscribe_topic = cancel


def sent(plan, client, batch_seconds=0.0, stop=None, begun=lambda batch: None, held=None):
    """What a plan gives on a client: arrays, reports, and the ``Sending`` that did it. ``held``: batches under way,
    results kept.
    """
    jobs = make_jobs(plan, set(plan.cells), lambda cell: None, deliver_all=True)
    arrays, reports = {}, {}

    def before(batch):
        begun(batch)
        if held is not None:
            held.append((len(sending.sent), len(sending.results)))

    def after(batch, result):
        arrays.update(result.kept)
        for report in result.reports:
            assert (report.stage, report.index) not in reports  # each cell once
            reports[report.stage, report.index] = report

    batches = partition(jobs, batch_seconds)
    common = common_of("test", (), platform_record, None)
    sending = Sending(client, batches, frozenset(jobs), before, after, common, stop or Stop(), None)
    sending.run()
    return arrays, reports, sending


@pytest.mark.parametrize("batch_seconds", [0.0, 0.005, 1e3])
def test_all_batches_end_with_the_bits_of_a_serial_run_and_nothing_is_held_on_to(batch_seconds):
    plan, client = plan_of(SWEEP), Client()
    arrays, reports, sending = sent(plan, client, batch_seconds)
    assert set(reports) == set(plan.cells)
    assert_same_arrays(labelled(plan, arrays), labelled(plan, run(plan).arrays))
    assert not sending.results and not sending.sent and not sending.unfinished


def test_what_is_held_at_once_does_not_grow_with_the_sweep():
    most = {}
    for count in (4, 12, 36):
        held = []
        plan = plan_of({"sweep.integration_time": [f"{n} ms" for n in range(1, count + 1)], "wanted": ["raw"]})
        _, _, sending = sent(plan, Client(), held=held)
        assert len(held) == len(sending.batches) > 2 * count
        assert max(under_way for under_way, _ in held) <= AHEAD * WORKERS
        most[count] = max(results for _, results in held)
    # of the chain of each batch that is under way or just ended the newest result, and the light in front of them all
    assert max(most.values()) <= 2 * AHEAD * WORKERS + len(plan.nodes)


def test_of_a_batch_of_which_workers_die_only_the_guilty_cell_fails():
    plan = plan_of({"sweep.integration_time": ["2 ms", "8 ms", "16 ms"]})
    jobs = make_jobs(plan, set(plan.cells), lambda cell: None, deliver_all=True)
    guilty = ("shot_noise", next(cell.index for cell in plan.of("shot_noise")[1:]))
    client = Client(guilty)
    arrays, reports, sending = sent(plan, client, 1e3)
    whole = run(plan)
    failed = {ref for ref, report in reports.items() if report.status == "failed"}
    assert failed == {guilty}
    assert "every worker that computed it died, although it ran alone" in reports[guilty].message
    skipped = {ref for ref, report in reports.items() if report.status == "skipped"}
    assert skipped == {ref for ref in plan.cells if jobs[ref].ref != guilty and _reads(jobs, ref, guilty)}
    rest = {ref: own for ref, own in arrays.items() if ref not in failed | skipped}
    assert_same_arrays(
        labelled(plan, rest), labelled(plan, {ref: own for ref, own in whole.arrays.items() if ref in rest})
    )
    assert not sending.results


def _reads(jobs, ref, guilty):
    return ref == guilty or any(_reads(jobs, need, guilty) for need in jobs[ref].needs)


def test_a_run_that_is_stopped_sends_nothing_more_and_takes_what_was_under_way():
    plan, client, stop, begun = plan_of(SWEEP), Client(), Stop(), []

    def before(batch):
        begun.append(batch.number)
        if len(begun) == 5:
            stop.ask()

    with pytest.raises(Stopped):
        sent(plan, client, stop=stop, begun=before)
    assert len(begun) <= 5 + AHEAD * WORKERS
    assert not stop.abandoned


def test_without_workers_and_with_paused_ones_a_run_ends_in_words(monkeypatch):
    monkeypatch.setattr(watching, "PATIENCE", 0.2)
    monkeypatch.setattr(watching, "AGAIN", 0.05)
    plan, client = plan_of(), Client()
    client.workers = {}
    with pytest.raises(MachineError, match="there has been no worker for"):
        sent(plan, client)
    client.workers = {"tcp://1": {"nthreads": 0, "memory_limit": 1, "status": "paused"}}
    with pytest.raises(MachineError, match="no worker has been running for .*they are paused"):
        sent(plan, client)


# -- who may compute
# ------------------------------------------------------------------------------------------------------------


def test_a_worker_says_in_what_it_differs(tmp_path):
    from etendue.contract.registry import installed_stages

    kinds = [installed_stages().load(name) for name in ("pixel", "demosaic_malvar")]
    mark = tmp_path / "run.id"
    mark.write_bytes(b"mine")
    common = common_of("run", kinds, platform_record, (str(mark), b"mine"))
    assert common.differences() == []
    here = common.has
    other = replace(common, has={**here, "numpy": "1.0", "cpu_features": "none"})
    assert other.differences() == [f"numpy {here['numpy']} (here 1.0)", "other processor features"]
    module, kind = next(key for key in common.code if "malvar" in key[0])
    other = replace(common, code={**common.code, (module, kind): ("another", "etendue-demosaic-malvar 9")})
    assert (
        "different code of the stage" in other.differences()[0]
        and "here etendue-demosaic-malvar 9" in other.differences()[0]
    )
    other = replace(common, code={("no_such_module", "Kind"): ("", "theirs 2.0")})
    assert other.differences()[0].startswith("no stage Kind of theirs 2.0")
    mark.write_bytes(b"another run's")
    assert common.differences() == [f"another folder at {tmp_path}, the path of the archive"]
    mark.unlink()
    assert common.differences()[0].startswith(f"no archive at {tmp_path}")


def test_a_scheduler_that_cannot_be_reached_is_said_to_be_that(monkeypatch):
    pytest.importorskip("distributed")
    monkeypatch.setattr(connect, "ANSWER", "0.3s")
    with pytest.raises(
        MachineError, match=r"tcp://127.0.0.1:9: no Dask scheduler answers there .*dask scheduler.*--scheduler threads"
    ):
        connect.run_on_cluster([], frozenset(), None, None, How("tcp://127.0.0.1:9", 1, Stop()))


# -- on processes
# ---------------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def driver():
    pytest.importorskip("distributed")
    pytest.importorskip("cryptography")
    found = importlib.util.spec_from_file_location("cluster_driver", DRIVER)
    module = importlib.util.module_from_spec(found)
    sys.modules["cluster_driver"] = module
    sys.path.insert(0, str(DRIVER.parent))  # its own rooms stand beside it
    try:
        found.loader.exec_module(module)
    finally:
        sys.path.remove(str(DRIVER.parent))
    return module


@pytest.mark.long
@pytest.mark.parametrize("fault", ["cells", "schedulers", "strangers", "signals", "workers", "owners"])
def test_faults_of_a_cluster_end_as_expected_and_the_same_command_again_finishes(driver, tmp_path, fault):
    seen = list(driver.FAULTS[fault](driver.Place(tmp_path), random.Random(1), 4))
    assert seen
    for one in seen:
        assert one.right == one.tried > 0, (one.fault, one.expected, one.wrong)
