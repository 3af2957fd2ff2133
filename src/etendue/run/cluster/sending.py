"""Send batches to a cluster as they become ready, few per worker thread: scheduler and workers hold only running tasks,
not the graph.

In:  batches in any order; a client.
Out: ``after`` is called for every batch. Results stay with the workers until their last reader has ended; only reports
     and requested arrays are fetched.
"""

from __future__ import annotations

import heapq
import queue
import time
from collections.abc import Callable, Set
from dataclasses import dataclass, field
from typing import Any

from etendue.plan.model import CellRef
from etendue.run.batches import Batch, BatchResult
from etendue.run.cluster.alike import Common
from etendue.run.cluster.suspects import Suspects
from etendue.run.cluster.tasks import as_bytes, compute, compute_and_tell, told
from etendue.run.cluster.watching import Watching
from etendue.run.order import depth_first
from etendue.run.watch import GRACE, Stop, Stopped

AHEAD = 3  # batches sent per worker thread: one running, the others so that it need not wait
LOOK = 0.2  # seconds between polls of what is not reported


@dataclass
class Sent:
    """A batch in progress: its result, if other batches read it, and the data fetched at its end."""

    result: Any
    told: Any
    at: float = field(default_factory=time.monotonic)


class Sending:
    """The batches of one run on one cluster."""

    def __init__(
        self,
        client: Any,
        batches: list[Batch],
        deliver: Set[CellRef],
        before: Callable[[Batch], None],
        after: Callable[[Batch, BatchResult], None],
        common: Common,
        stop: Stop,
        limit: float | None,
    ) -> None:
        self.client, self.deliver, self.common, self.stop = client, deliver, common, stop
        self.before, self.after = before, after
        self.batches = {batch.number: batch for batch in batches}
        self.place = {n: place for place, n in enumerate(depth_first(self.batches, lambda n: self.batches[n].imports))}
        self.awaits = {batch.number: len(batch.imports) for batch in batches}
        self.readers: dict[int, list[int]] = {}
        for batch in batches:
            for number in batch.imports:
                self.readers.setdefault(number, []).append(batch.number)
        self.unread = {number: len(readers) for number, readers in self.readers.items()}
        self.ready = [(self.place[n], n) for n, count in self.awaits.items() if not count]
        heapq.heapify(self.ready)
        self.unfinished = set(self.batches)
        self.sent: dict[int, Sent] = {}
        self.results: dict[int, Any] = {}  # results of ended batches that are still read
        self.suspected: list[int] = []
        self.ended: queue.SimpleQueue[tuple[int, Any]] = queue.SimpleQueue()
        self.watching = Watching(client, stop, limit, self.common.run)
        self.suspects = Suspects(client, self.batches, self.results, deliver, common, self.watching)

    def run(self) -> None:
        """Run until all batches have ended.

        Raises
        ------
        MachineError
            The cluster cannot continue: no worker is left, or a worker differs.
        Stopped
            The run was stopped, and running batches have had time to end.
        """
        with self.watching:
            try:
                while self.unfinished:
                    self.stop.check()
                    self.send()
                    self.take(LOOK)
                    for number in self.watching.overdue({n: len(self.batches[n].jobs) for n in self.sent}):
                        self.watching.kill_the_worker_of(self.sent.pop(number).told)
                        self.suspected.append(number)
                    if self.suspected and not self.sent:
                        self.examine()
            except Stopped:
                self.wind_up()
                raise

    def send(self) -> None:
        """Send ready batches while workers have room. Send none while a batch is suspected of killing its worker,
        because that batch is tried alone.
        """
        ahead = AHEAD if self.watching.limit is None else 1  # with a time limit, a batch must not wait behind another
        while self.ready and not self.suspected and len(self.sent) < ahead * self.watching.threads():
            place, number = heapq.heappop(self.ready)
            batch = self.batches[number]
            self.before(batch)
            inputs = sorted(batch.imports)
            topic = self.watching.topic if self.watching.limit is not None else ""
            data = as_bytes(
                batch.jobs, batch.exports, [batch.imports[n] for n in inputs], self.deliver, topic=topic, number=number
            )
            how = {"pure": False, "priority": -place}
            before = [self.results[n] for n in inputs]
            if self.readers.get(number):
                result = self.client.submit(compute, self.common, data, *before, **how)
                self.sent[number] = Sent(result, self.client.submit(told, result, **how))
            else:
                self.sent[number] = Sent(None, self.client.submit(compute_and_tell, self.common, data, *before, **how))
            self.sent[number].told.add_done_callback(lambda future, number=number: self.ended.put((number, future)))

    def take(self, wait: float) -> None:
        """Wait for batches to end and take their reports; batches whose workers died become suspects."""
        try:
            found = [self.ended.get(timeout=wait)]
        except queue.Empty:
            self.watching.look(bool(self.sent or self.ready))
            return
        while not self.ended.empty():
            found.append(self.ended.get())
        found = [
            (number, future) for number, future in found if number in self.sent and self.sent[number].told is future
        ]
        sound = [(number, future) for number, future in found if future.status == "finished"]
        for number, future in found:
            if future.status != "finished":
                self.watching.died(future)
                del self.sent[number]
                self.suspected.append(number)
        if sound:
            self.watching.moved()
            for (number, _), tale in zip(sound, self.client.gather([future for _, future in sound]), strict=True):
                self.finish(number, self.sent.pop(number).result, tale)

    def examine(self) -> None:
        """Retry batches whose workers died, while nothing else is running."""
        for number in sorted(self.suspected, key=self.place.__getitem__):
            result = self.suspects.one_by_one(self.batches[number])
            self.finish(number, result, self.watching.answer(self.client.submit(told, result, pure=False)))
        self.suspected.clear()

    def finish(self, number: int, result: Any, tale: Any) -> None:
        batch = self.batches[number]
        self.after(batch, BatchResult({}, *tale))
        self.unfinished.discard(number)
        for n in batch.imports:  # release results that are no longer read
            self.unread[n] -= 1
            if not self.unread[n]:
                del self.results[n]
        for reader in self.readers.get(number, ()):
            self.results[number] = result
            self.awaits[reader] -= 1
            if not self.awaits[reader]:
                heapq.heappush(self.ready, (self.place[reader], reader))

    def wind_up(self) -> None:
        """Stop the run: cancel batches that have not started, and let running batches end."""
        until = time.monotonic() + 0.6 * GRACE
        try:
            at_work = self.watching.at_work()
            for number in [
                n
                for n, sent in self.sent.items()
                if sent.told.key not in at_work and getattr(sent.result, "key", None) not in at_work
            ]:
                sent = self.sent.pop(number)
                self.client.cancel([future for future in (sent.result, sent.told) if future is not None])
            while self.sent and time.monotonic() < until:
                self.take(LOOK / 4)
        except Exception:  # the cluster may be lost as well
            pass
        self.stop.abandoned = bool(self.sent)
