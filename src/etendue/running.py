"""A run in progress: cells are computed, and their results are passed to the store and shown.

In: the remaining cells of a plan, a store of results.
Out: reports, arrays of the shown cells, the pictures. ``session`` begins and ends it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

from etendue import interrupts
from etendue.compute.job import Job
from etendue.compute.jobs import make_jobs
from etendue.contract.ports import ContactSheet, Keeper, Progress
from etendue.plan.model import CellRef
from etendue.plan.reports import DONE, LEFT_OUT, Reports
from etendue.plan.resume import Work
from etendue.present.pictures import pictures, small_maps, thumbnails
from etendue.present.pictures.thumbnails import Thumbnail
from etendue.present.terminal import tables
from etendue.run.batches import Batch, BatchResult
from etendue.run.schedulers import scheduler as scheduler_of
from etendue.run.watch import Stop, run_batches
from etendue.types.documents import Document

if TYPE_CHECKING:
    from etendue.session import Options
    from etendue.types.arrays import Array

Cut = Callable[[Mapping[CellRef, Job], float], list[Batch]]  # cuts jobs into batches of about this many seconds


class Running:
    """A run of a plan that covers all cells in the store.

    Attributes
    ----------
    shown : by stage, the cell shown as a picture
    arrays : the arrays that the store does not hold: of the shown cells, and of all cells that are kept in memory
    small : by shown cell, the arrays from which its pictures are made
    earlier : finished cells whose reports are only in the store
    """

    def __init__(self, work: Work, shown: Mapping[str, CellRef], keeper: Keeper, progress: Progress) -> None:
        self.work, self.plan, self.shown, self.keeper, self.progress = work, work.plan, shown, keeper, progress
        self.looks = thumbnails.looks(self.plan, shown.values()) if keeper.draws else {}
        self.reports = Reports(self.plan)
        self.arrays: dict[CellRef, dict[str, Array]] = {}
        self.small: dict[CellRef, dict[str, Thumbnail]] = {}
        self.earlier: list[CellRef] = []

    def compute(self, options: Options, cut: Cut) -> None:
        """Compute all remaining cells, in batches. If interrupted, finished results remain in the store."""
        work, keeper = self.work, self.keeper
        show = frozenset(ref for ref in self.shown.values() if ref in self.looks and ref in work.todo)
        jobs: Mapping[CellRef, Job] = {}  # made only if needed, because this visits all cells of the plan
        if work.todo:
            jobs = make_jobs(
                self.plan,
                work.todo,
                keeper.target,
                deliver_all=keeper.keeps_arrays,
                show=show,
                place=keeper.place if scheduler_of(options.scheduler).here else None,
                looks={ref: one.beside(keeper.keeps_arrays, self.plan.kept, ref[0]) for ref, one in self.looks.items()},
            )
        self.progress.begin(len(work.todo))
        stop = Stop()
        try:
            interrupts.check()
            batches, deliver = cut(jobs, options.batch_seconds), work.todo if keeper.keeps_arrays else show
            run_batches(batches, deliver, self._before, self._after, options.how(stop, keeper.mark))
        except KeyboardInterrupt:
            self._take_earlier()
            keeper.interrupted(self.tables(), stop.abandoned)
            raise
        finally:
            self.progress.end()
        self._take_earlier()

    def _before(self, batch: Batch) -> None:
        self.keeper.starting(ref for ref in batch.refs if ref in self.work.todo)
        self.progress.starting(batch.stages)

    def _after(self, batch: Batch, result: BatchResult) -> None:
        fresh = tuple(r for r in result.reports if r.status != "loaded")
        for ref, found in self.keeper.finished(fresh, result.kept).items():
            look = self.looks.get(ref)
            if look:
                self.small[ref] = thumbnails.only(look(found))
            own = {v for v in found if (ref[0], v) in self.plan.kept} if self.keeper.keeps_arrays else set[str]()
            if not self.keeper.keeps_arrays or len(own) < len(found):  # otherwise the store holds all of it
                small = self.small.get(ref, {})
                self.arrays[ref] = {v: a for v, a in found.items() if v in own or v not in small}
        # The scheduler keeps its results alive; drop the arrays here, now that the store has what must be kept.
        result.kept, result.reports = {}, ()
        self.reports.take(fresh)
        self.progress.finished(fresh)

    def _take_earlier(self) -> None:
        self.earlier = [ref for ref in self.work.reused if ref not in self.reports]
        self.reports.take(self.keeper.earlier(self.earlier))

    # -- after the last cell -----------------------------------------------------------------------------------------

    def tables(self) -> dict[str, Document]:
        return {"ledger": tables.ledger(self.plan, self.reports), "summary": tables.summary(self.plan, self.reports)}

    @property
    def there(self) -> list[CellRef]:
        """Return the shown cells that an earlier run has computed."""
        return [ref for ref in self.shown.values() if ref not in self.work.todo]

    def sheet(self, at: str) -> ContactSheet | None:
        """Return pictures of the shown cells, whose axis values are ``at``; None if the pictures of an earlier run are
        kept.
        """
        keeper = self.keeper
        if keeper.draws and (self.arrays or keeper.lacks_pictures(self.shown.values())):
            for one in self.there:
                if one in self.looks:
                    self.small[one] = thumbnails.only(keeper.look_at(one, self.looks[one]))
            return pictures.sheet(self.plan, self.shown, self.small, at, self._maps)
        mapped = (ref for one in small_maps.small_maps(self.plan) for ref in one.cells) if keeper.folder else ()
        if keeper.folder and any(ref in self.reports and ref in self.work.todo for ref in mapped):
            return pictures.same_pictures(keeper.folder, self._maps)
        return None

    def _maps(self) -> list[Array]:
        """Return the maps of metrics over the sweep, as on the contact sheet."""
        chosen = small_maps.small_maps(self.plan) if self.keeper.folder else []
        refs = dict.fromkeys(ref for one in chosen for ref in one.cells)
        states = {ref: self.reports[ref].status for ref in refs if ref in self.reports}
        done = [ref for ref, state in states.items() if state in ("done", "left_out")]
        figures = self.keeper.stored(done, True, frozenset(one.variable for one in chosen))
        lost = [ref for ref, state in states.items() if state in ("failed", "skipped")]
        return small_maps.all_drawn(chosen, figures, lost)

    def standing(self) -> Mapping[CellRef, dict[str, Array]]:
        """Return the arrays of all computed cells, as stored; for shown cells of earlier runs, their metrics."""
        self.arrays.update(self.keeper.stored(self.there, figures_only=True))
        return self.keeper.standing(self.arrays)

    def restored(self) -> int:
        """Return the number of cells of earlier runs that were computed again although they were not requested."""
        asked = set(self.work.cells.values())
        return sum((r.stage, r.index) not in asked for r in self.reports.having(DONE, LEFT_OUT))
