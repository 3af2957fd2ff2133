"""Batches: a partition of the jobs without circles, whatever the graph; serial and threads give the same."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from etendue.compute.job import Job
from etendue.compute.joined.segments import Light, Result
from etendue.contract.arrays.grid import Grid
from etendue.contract.arrays.variables import parse_declaration
from etendue.contract.stage import Stage
from etendue.run import batches as batches_of
from etendue.run import ready as ready_of
from etendue.run.batches import partition, run_batch
from etendue.run.order import depth_first
from etendue.run.ready import Ready
from etendue.run.schedulers import SCHEDULERS, How
from etendue.run.watch import Stop

PORTS = ("a", "b", "c")


WORD, PAIR = parse_declaration("out", "[1]"), ("out", "other")


def _mixed(number, *arrays):
    """A value that changes with every input and with their order."""
    return {"out": np.array(sum((i + 2) * float(a) for i, a in enumerate(arrays)) % 1.0 + number / 1024)}


@dataclass(frozen=True, kw_only=True)
class Zero(Stage):
    writes: ClassVar = {"out": "[1]"}
    number: int = 0

    def run(self):
        return _mixed(self.number)


@dataclass(frozen=True, kw_only=True)
class One(Zero):
    reads: ClassVar = {"a": "out: [1]"}

    def run(self, a):
        return _mixed(self.number, a)


@dataclass(frozen=True, kw_only=True)
class Pair(Stage):
    writes: ClassVar = {"out": "[1]", "other": "[1]"}

    def run(self):
        return {"out": np.array(1.0), "other": np.array(2.0)}


@dataclass(frozen=True, kw_only=True)
class Other(Stage):
    reads: ClassVar = {"a": "other: [1]"}
    writes: ClassVar = {"out": "[1]"}

    def run(self, a):
        return {"out": a + 1.0}


@dataclass(frozen=True, kw_only=True)
class Two(Zero):
    reads: ClassVar = {"a": "out: [1]", "b": "out: [1]"}

    def run(self, a, b):
        return _mixed(self.number, a, b)


@dataclass(frozen=True, kw_only=True)
class Three(Zero):
    reads: ClassVar = {"a": "out: [1]", "b": "out: [1]", "c": "out: [1]"}

    def run(self, a, b, c):
        return _mixed(self.number, a, b, c)


def job_of(number, needs, seconds):
    stage = (Zero, One, Two, Three)[len(needs)](number=number)
    return Job(
        ref=(f"n{number}", ()),
        task="compute",
        stage=stage,
        writes={"out": parse_declaration("out", "[1]")},
        grids={"out": Grid()},
        input_grids={port: Grid() for port in PORTS[: len(needs)]},
        inputs=tuple((p, (f"n{n}", ()), "out") for p, n in zip(PORTS, needs, strict=False)),
        left_out=False,
        seed=b"",
        pattern_of=b"",
        precision="float64",
        store=(),
        deliver=("out",),
        target=None,
        seconds=seconds,
    )


@st.composite
def graphs(draw):
    """Jobs that read up to three earlier ones: chains, fans, diamonds, islands."""
    jobs = {}
    for number in range(draw(st.integers(1, 40))):
        earlier = st.integers(0, number - 1)
        needs = draw(st.lists(earlier, max_size=3, unique=True)) if number else []
        job = job_of(number, needs, draw(st.sampled_from([0.0, 1e-4, 0.03, 0.2])))
        jobs[job.ref] = job
    return jobs


def in_order(batches):
    by_number = {batch.number: batch for batch in batches}
    return [by_number[n] for n in depth_first(by_number, lambda n: by_number[n].inputs)]


TARGETS = st.sampled_from([0.0, 0.05, 0.1, 1.0, float("inf")])


@given(graphs(), TARGETS)
def test_each_job_is_in_exactly_one_batch(jobs, target):
    found = [job.ref for batch in partition(jobs, target) for job in batch.jobs]
    assert len(found) == len(jobs)
    assert set(found) == set(jobs)


@given(graphs(), TARGETS)
def test_levels_rise_strictly_along_every_dependency_between_batches(jobs, target):
    """So the graph of batches has no circle."""
    batches = partition(jobs, target)
    home = {job.ref: batch for batch in batches for job in batch.jobs}
    for batch in batches:
        for job in batch.jobs:
            for ref in job.needs:
                assert home[ref] is batch or home[ref].level < batch.level
        assert batch.inputs == set(batch.imports)
        assert batch.inputs == {home[ref].number for job in batch.jobs for ref in job.needs} - {batch.number}


@given(graphs(), TARGETS)
def test_jobs_of_a_batch_stand_behind_what_they_read(jobs, target):
    for batch in partition(jobs, target):
        before = set()
        for job in batch.jobs:
            own = {other.ref for other in batch.jobs}
            assert set(job.needs) & own <= before
            before.add(job.ref)


@given(graphs(), st.sampled_from([0.05, 0.1, 1.0]))
def test_a_batch_is_no_larger_than_asked_unless_a_single_job_is(jobs, target):
    for batch in partition(jobs, target):
        assert sum(job.seconds for job in batch.jobs) <= target * (1 + 1e-12) or len(batch.jobs) == 1


@given(graphs(), TARGETS)
def test_a_batch_exports_what_another_reads_and_nothing_else(jobs, target):
    batches = partition(jobs, target)
    read = {ref for batch in batches for refs in batch.imports.values() for ref in refs}
    assert {ref for batch in batches for ref in batch.exports} == read
    finished = {}
    for batch in in_order(batches):
        inputs = sorted(batch.imports)
        result = run_batch(
            tuple(batch.jobs),
            batch.exports,
            tuple(tuple(batch.imports[n]) for n in inputs),
            frozenset(),
            *(finished[n] for n in inputs),
        )
        finished[batch.number] = result
        assert set(result.results) == set(batch.exports)
        assert result.kept == {}


@given(graphs())
def test_depth_first_is_an_order_of_all_jobs_behind_what_they_read(jobs):
    seen = set()
    for ref in depth_first(jobs, lambda r: jobs[r].needs):
        assert set(jobs[ref].needs) <= seen
        seen.add(ref)
    assert seen == set(jobs)


def values_of(jobs, target, run):
    kept, told = {}, {"before": [], "after": []}

    def after(batch, result):
        told["after"].append(batch.number)
        assert all(report.status == "done" for report in result.reports)
        kept.update(result.kept)

    batches = partition(jobs, target)
    run(batches, frozenset(jobs), lambda batch: told["before"].append(batch.number), after)
    assert sorted(told["before"]) == sorted(told["after"]) == list(range(len(batches)))
    return {ref: float(arrays["out"]) for ref, arrays in kept.items()}


@settings(max_examples=40, deadline=None)
@given(graphs(), TARGETS)
def test_serial_and_threads_give_what_the_graph_says(jobs, target):
    by_hand = {}
    for ref, job in jobs.items():
        by_hand[ref] = float(_mixed(job.stage.number, *(by_hand[r] for r in job.needs))["out"])
    for name in ("serial", "threads"):
        assert (
            values_of(jobs, target, lambda *a, name=name: SCHEDULERS[name].run()(*a, How(name, 2, Stop()))) == by_hand
        )


@settings(max_examples=60, deadline=None)
@given(graphs(), TARGETS, st.integers(1, 5), st.randoms(use_true_random=False))
def test_chains_are_continued_before_more_of_them_are_opened(jobs, target, workers, chance):
    """Whichever batch ends first: each runs once, behind what it reads; the first in order that may; few that open."""
    batches = partition(jobs, target)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ready_of, "LARGE", 1)
        ready, under_way, ended = Ready(batches, workers), [], set()
        while ready.heap or under_way:
            waiting = {number for _, number in ready.heap}
            while len(under_way) < workers and (new := ready.next()) is not None:
                passed = {n for n in waiting if ready.place[n] < ready.place[new.number]}
                assert all(ready.opens(ready.batches[n]) for n in passed)
                assert new.inputs <= ended
                waiting.discard(new.number)
                under_way.append(new)
            assert under_way
            assert sum(batch.number in ready.opening for batch in under_way) <= max(workers // 2, 1)
            done = under_way.pop(chance.randrange(len(under_way)))
            ready.ended(done, done.number)
            ended.add(done.number)
            assert set(ready.results) <= ended
    assert ended == set(range(len(batches)))
    assert not ready.results


@settings(max_examples=60, deadline=None)
@given(graphs(), TARGETS, st.integers(1, 5))
def test_a_chain_is_held_back_until_those_before_it_are_read(jobs, target, workers):
    """A batch waits only for earlier ones, so there is no circle, and for every reader of earlier chains."""
    batches = partition(jobs, target)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ready_of, "LARGE", 1)
        ready = Ready(batches, workers)
        held, openings = ready.held_back(), ready.openings()
        assert list(held) == openings[ready.most :]
    before: dict[int, set[int]] = {}
    for number in sorted(ready.batches, key=ready.place.__getitem__):
        direct = {*ready.batches[number].inputs, *held.get(number, ())}
        assert all(ready.place[one] < ready.place[number] for one in direct)
        before[number] = direct.union(*(before[one] for one in direct))
    for earlier, now in zip(openings, openings[ready.most :], strict=False):
        readers = {one for one in ready.readers[earlier] if ready.place[one] < ready.place[now]} - set(openings)
        assert readers <= before[now] | {*held[now]}


def test_a_large_array_ends_with_its_last_reader_and_the_rest_of_its_cell_stays(monkeypatch):
    monkeypatch.setattr(batches_of, "LARGE", 0)
    first = replace(job_of(0, [], 0.1), writes={"out": WORD, "other": WORD}, deliver=("out", "other"))
    first = replace(first, grids={"out": Grid(), "other": Grid()}, stage=Pair())
    middle, last = job_of(1, [0], 0.1), replace(job_of(2, [0], 0.1), inputs=(("a", ("n0", ()), "other"),))
    last = replace(last, stage=Other(), writes={"out": WORD})
    for exports, names in (({}, ()), ({("n0", ()): frozenset({"other"})}, ("other",)), ({("n0", ()): None}, PAIR)):
        found = run_batch((first, middle, last), exports, (), frozenset())
        assert [report.status for report in found.reports] == ["done"] * 3
        assert [tuple(result.arrays) for result in found.results.values()] == ([names] if exports else [])


def test_siblings_behind_the_same_two_batches_share_a_batch():
    """A diamond with many jobs at its foot must not end in as many tasks."""
    jobs = {
        job.ref: job
        for job in [job_of(0, [], 0.1), job_of(1, [], 0.1), *(job_of(2 + i, [0, 1], 0.001) for i in range(90))]
    }
    assert len(partition(jobs, 0.1)) == 3


def test_what_a_batch_reads_from_another_is_read_only():
    """A trip through pickle makes arrays writable again; a stage must not see that."""
    results = Result({"out": np.zeros(2)}, light=Light(made=(np.zeros(2, complex), ()))).read_only()
    assert not results.arrays["out"].flags.writeable
    assert not results.light.made[0].flags.writeable
