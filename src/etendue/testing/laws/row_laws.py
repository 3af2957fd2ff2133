"""The law for stages that can be given some rows of a frame.

In:  an instance of a stage.
Out: nothing, or a broken law.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from etendue.archive.read.differing import full_scale
from etendue.compute.rows import has_rows
from etendue.contract.capabilities import halo_of
from etendue.testing.bench import FRAME, PRECISIONS, Bench, LawBroken, digests, largest_difference
from etendue.testing.laws.window_laws import FARTHEST
from etendue.testing.measured import hold, ratio_of, untried
from etendue.types.arrays import Array


class RowLaws:
    """Mix-in of ``StageConformance``."""

    bench: Bench

    def test_rows_alone_are_the_rows_of_the_whole(self) -> None:
        """A stage with a ``halo``, or an ``elementwise`` stage, gives the same bits in strips of any height."""
        bench = self.bench
        try:
            halo = halo_of(bench.stage)
        except TypeError as error:
            raise LawBroken(str(error)) from None
        if halo is None or not any(has_rows(declaration.dims) for declaration in bench.writes.values()):
            return
        if halo > FARTHEST:
            untried(f"it reaches {halo} pixels: strips are tried up to {FARTHEST}")
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
                        raise LawBroken(f"{bench.name} fails on {rows} rows of {frame[0]} at a time: {error}") from None
                    one, other = digests(whole.arrays), digests(cut.arrays)
                    apart = sorted(name for name in one if other.get(name) != one[name])
                    hold(
                        not apart,
                        f"{bench.name} gives different bits of {', '.join(apart)} {rows} rows at a time than at once, "
                        f"with a halo of "
                        f"{halo}{_differing(whole.arrays, cut.arrays, apart)}: state the halo that it needs "
                        f"(def halo(self): return "
                        f"{halo + 1}), or return None if only rounding differs",
                    )


def _differing(whole: Mapping[str, Array], cut: Mapping[str, Array], names: list[str]) -> str:
    """Return a text with the largest difference between the arrays ``names``, relative to the largest value; '' if they
    are not numeric or differ in shape.
    """
    shares = []
    for name in names:
        one, other = np.asarray(whole[name]), np.asarray(cut.get(name))
        if one.shape != other.shape or one.dtype.kind not in "iufb":
            return ""
        shares.append(ratio_of(largest_difference(one, other), full_scale(one)))
    return f", by up to {max(shares):.1g} of the largest value" if shares else ""
