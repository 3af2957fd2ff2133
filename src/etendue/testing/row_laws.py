"""The law of stages that may be given some rows of a frame.

In:  an instance of a stage.
Out: nothing, or a broken law.
"""

from __future__ import annotations

from etendue.plan.strips import has_rows
from etendue.spec.capabilities import halo_of
from etendue.testing.bench import FRAME, PRECISIONS, Bench, LawBroken, digests
from etendue.testing.measured import hold


class RowLaws:
    """Mixed into ``StageConformance``."""

    bench: Bench

    def test_rows_alone_are_the_rows_of_the_whole(self) -> None:
        """A stage with a ``halo``, or an ``elementwise`` one, gives the same bits strip by strip, of any height."""
        bench = self.bench
        try:
            halo = halo_of(bench.stage)
        except TypeError as error:
            raise LawBroken(str(error)) from None
        if halo is None or not any(has_rows(declaration.dims) for declaration in bench.writes.values()):
            return
        frame = FRAME if bench.given_grids else (FRAME[0] + 2 * halo, FRAME[1])
        for precision in PRECISIONS:
            for what in ("ordinary", "decades"):
                inputs = bench.arrays(what, frame)
                whole = bench.run(inputs, precision, frame)
                for rows in (1, 2, 5) if whole.done else ():
                    try:
                        cut = bench.run(inputs, precision, frame, rows=rows)
                    except Exception as error:
                        raise LawBroken(f"{bench.name} cannot be given {rows} rows of {frame[0]} at a time: {error}") from None
                    one, other = digests(whole.arrays), digests(cut.arrays)
                    apart = sorted(name for name in one if other.get(name) != one[name])
                    hold(
                        not apart,
                        f"{bench.name} gives other bits of {', '.join(apart)} {rows} rows at a time than all at once, with a halo of "
                        f"{halo}: state how far it reaches, or None",
                    )
