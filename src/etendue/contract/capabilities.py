"""Capabilities of stages in addition to ``run``, as typed base classes, tested with ``issubclass``.

In:  a class of stages.
Out: whether the class is a source or a transfer function, is computed by band, may be left out, or looks at other
     stages.

Any stage may read ``"*.transfer [1]"``: the port gets the transfer functions of all stages before it, see ``Probe``.
"""

from __future__ import annotations

import dataclasses
from abc import abstractmethod
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, ClassVar

from etendue.contract.arrays.dims import banded, is_light
from etendue.contract.arrays.facts import Facts
from etendue.contract.arrays.grid import Grid
from etendue.contract.discretised import Discretised as Discretised
from etendue.contract.stage import (
    Stage,
    arguments_of,
    identity_of,
    names_asked,
    patterns_of,
    per_kind,
    reads_of,
    writes_of,
)

if TYPE_CHECKING:
    from etendue.types.arrays import Array


@dataclasses.dataclass(frozen=True, kw_only=True)
class Source(Stage):
    """A stage that reads nothing and describes its outputs before any array exists."""

    @abstractmethod
    def describe(self) -> tuple[Facts, Mapping[str, Grid]]: ...

    def white_light(self, edges: tuple[float, ...]) -> Array | None:
        """Return the light of a white surface in bands with these edges, (band,), in any scale; metrics weight the
        bands by it. Return None if it is unknown; metrics then assume light that is equally strong in all bands."""
        return None


@dataclasses.dataclass(frozen=True, kw_only=True)
class Tinting(Stage):
    """A stage that absorbs light by band, uniformly over the frame, as a filter does."""

    @abstractmethod
    def transmission(self, grid: Grid) -> Array:
        """(band,): the transmission in the bands of a grid."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Transfer(Stage):
    """A linear shift-invariant stage: it has a transfer function instead of ``run``. ``radial``: the function depends
    only on the magnitude of the frequency. The stage reads and writes one variable."""

    radial: ClassVar[bool] = False

    @abstractmethod
    def transfer(self, *given: Any, **named: Any) -> Array:
        """Return the transfer function at separable frequencies ``(fy, fx, centres of the bands)``, in cycles/um, and
        centres in the unit that the dim of the bands declares as ``asked_in``. The result of ``prepare``, if the stage
        has that method, is passed as ``prepared``."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Summed(Transfer):
    """A transfer stage that ends with a weighted sum over the bands, as a pixel under its filters does."""

    @abstractmethod
    def weights(self, prepared: Any) -> Array:
        """(channel, band): the weights of the sum."""

    def shares(self, prepared: Any) -> Array | None:
        """(channel, band): the weights divided by the sum of their channel. None: they are calculated from the weights.
        Stages whose weights differ only by a common factor, as pixels of several sizes do, share transforms if this
        method gives the same bits for them.
        """
        return None

    def segment_error(
        self, before: tuple[Transfer, ...], facts: Any, grid: Mapping[str, Grid], precision: str
    ) -> tuple[float | None, str]:
        """Return the error of the sum if the stages ``before`` are joined to it, relative to full scale, and the basis
        of the error.
        """
        return self.error(facts, grid, precision)

    def terms(self) -> int:
        """Return the number of terms into which the bands are combined before the transfer functions; 0: bands are not
        combined.
        """
        return 0

    def kept(self) -> float:
        """Return the share of the grid's Nyquist frequency up to which incident light is used; 1: all of it."""
        return 1.0


@dataclasses.dataclass(frozen=True, kw_only=True)
class ChannelTransfer(Stage):
    """A stage after the sum over bands that moves charge between pixels under any filters. It is linear and, over the
    pixels of a channel, shift-invariant on average. Stages that look at transfer functions see it combined with the
    transfer function of the pixel.
    """

    @abstractmethod
    def channel_transfer(self, fy: Array, fx: Array, light: Array, prepared: Any) -> Array:
        """Return the transfer at the frequencies fy (m,) and fx (n,), cycles/um, as an array (collecting channel,
        channel of the filter, m, n).

        ``light``: light of a white surface by band, (band,), in any scale."""

    def moves_charge(self) -> bool:
        """Return whether the stage moves charge with these parameters."""
        return True


@dataclasses.dataclass(frozen=True, kw_only=True)
class Banded(Stage):
    """A stage whose ``run`` can work on some of the bands."""

    @abstractmethod
    def by_band(self, prepared: Any, bands: slice) -> Any:
        """Return the part of ``prepared`` for these bands."""

    def in_rows(self) -> bool:
        """Return whether ``run`` gives the same bits if it gets only some rows: inputs and positions along y are then
        cut.
        """
        return False

    def constants(self, prepared: Any) -> Mapping[str, Array]:
        """Return, for a source, the outputs that have no dims y and x."""
        return {}

    def mixture(self, prepared: Any) -> tuple[Sequence[Array], Array] | None:
        """Return, for a source, planes (k, y, x) and weights (band, k): its light in a band is the sum of the planes
        times the weights of the band. Return None if the light of the source is not such a sum.
        """
        return None


@dataclasses.dataclass(frozen=True, kw_only=True)
class Haloed(Stage):
    """A stage in which every row depends only on rows near it: ``run`` can be given some rows of a frame and returns
    the same bits for them.

    Inputs with rows, and coordinates along y, are cut into strips; all other inputs (tables, numbers) are passed whole.
    Random numbers must be drawn in one call, in the order of the rows, and only without a halo. Strips begin on even
    rows and have at least as many rows as the halo.
    """

    def halo(self) -> int | None:
        """Return the number of rows above and below on which a row depends; None if it depends on the whole frame, with
        these parameters."""
        return 0

    def joined(self, parts: Mapping[str, Sequence[Array]], sizes: Sequence[int]) -> Mapping[str, Array]:
        """Return the outputs that have no rows, combined from the results of all strips; ``sizes``: the number of
        values of the first variable in each strip. The default method requires that these outputs are equal in all
        strips; a stage without a halo may override it."""
        apart = [name for name, values in parts.items() if any(not _equal(values[0], value) for value in values[1:])]
        if apart:
            raise ValueError(f"{type(self).__name__}: {', '.join(apart)} differ from strip to strip; define joined()")
        return {name: values[0] for name, values in parts.items()}


@dataclasses.dataclass(frozen=True, kw_only=True)
class Bounded(Stage):
    """A stage that may be left out if its effect is small: it reads and writes one variable on the same grid."""

    @abstractmethod
    def negligible(self, facts: Facts, grid: Grid) -> tuple[float, str] | None:
        """Return the error that leaving out the stage causes, relative to full scale, and the reason; None if the error
        is unknown.
        """


@dataclasses.dataclass(frozen=True, kw_only=True)
class Sampled(Stage):
    """A stage that draws random numbers or rounds, and can compute its mean output.

    Errors of a pipeline are measured by comparing these means. Outputs of ``run`` would not serve: an error d before
    rounding to steps of q becomes sqrt(d q) after it, and two draws of random numbers differ by their noise.
    """

    @abstractmethod
    def mean(self, *given: Any, **named: Any) -> Mapping[str, Array]:
        """Return the mean of the results of ``run``, before rounding: the same variables, as floats. This method may
        have the same arguments as ``run``, except random numbers.
        """


class Noisy(Stage):
    """A stage that adds noise to the signal at a position, and states its variance.

    ``by_line``: whole rows or columns share the noise. ``inherent``: the noise follows from the level alone, as in
    counting, so that it is known without a datasheet. Rounding is noise too, with a variance of a twelfth of its step
    squared.
    """

    by_line: ClassVar[bool] = False
    inherent: ClassVar[bool] = False

    @abstractmethod
    def variance(self, level: float) -> float:
        """Return the variance that the stage adds at a mean level, in the square of the unit of that level."""


class Datasheet(Stage):
    """A stage with a data sheet: numbers that a measurement can reproduce and that other stages may read."""

    @abstractmethod
    def datasheet(self) -> Mapping[str, float]:
        """Return the numbers of the data sheet, under the names that reading stages expect."""


@dataclasses.dataclass(frozen=True)
class Sheet:
    """The value that a port ``"*.datasheet"`` gets for a stage: its role and the numbers of its datasheet, if any."""

    role: str
    figures: Mapping[str, float]

    @classmethod
    def of(cls, stage: Stage) -> Sheet:
        return cls(stage.role, dict(stage.datasheet()) if isinstance(stage, Datasheet) else {})


@dataclasses.dataclass(frozen=True, kw_only=True)
class Probe(Stage):
    """A stage that looks at all stages in order: it reads ``"*.transfer"`` or ``"*.<variable>"``.

    For each such port ``run`` gets a list of (stage name, property or array of that stage). That is the transfer
    function up to and including the stage (``etendue.compute.joined.otf.Otf``), or the array itself; with
    ``with_grids`` the list has (stage name, array, grid). No stage reads from a probe. A probe may write the dim
    ``stage``, with an entry for every stage that it looks at, in order; ``run`` receives their names as ``stage``.
    Stages seen only through the ports in ``beside`` have no entry, and a ``ChannelTransfer`` shares the entry of the
    pixel.
    """

    with_grids: ClassVar[bool] = False
    beside: ClassVar[tuple[str, ...]] = ()


@dataclasses.dataclass(frozen=True, kw_only=True)
class Viewed(Stage):
    """A stage whose pictures are meant for a viewer adapted to a white other than the display's."""

    @abstractmethod
    def viewing_white(self) -> Array | None:
        """Return XYZ of the white to which the viewer is adapted; None if it is the white of the display."""


def is_source(kind: type[Stage]) -> bool:
    return issubclass(kind, Source)


def is_transfer(kind: type[Stage]) -> bool:
    return issubclass(kind, Transfer)


def _equal(one: Array, other: Array) -> bool:
    """Return whether two numbers or arrays are equal; NaN equals NaN."""
    same = (one == other) | ((one != one) & (other != other))
    return bool(same.all() if hasattr(same, "all") else same)


def halo_of(stage: Stage) -> int | None:
    """Return the number of rows above and below on which a row of a stage's output depends; None for the whole frame,
    or if it is unknown."""
    kind = type(stage)
    if isinstance(stage, Haloed):
        rows = stage.halo()
        if rows is not None and (isinstance(rows, bool) or not isinstance(rows, int) or rows < 0):
            raise TypeError(f"{kind.__name__}.halo returned {rows!r}; expected a number of rows, 0 or more, or None")
        # Random numbers must be drawn in the order of the rows, and a halo would draw rows at the seams twice.
        return None if rows and is_random(kind) else rows
    return 0 if kind.elementwise and not is_random(kind) else None


def is_seen_as_transfer(kind: type[Stage]) -> bool:
    """Return whether a stage has a transfer function that probes see, alone or combined with the pixel before it."""
    return issubclass(kind, Transfer | ChannelTransfer)


def ends_in_sum(kind: type[Stage]) -> bool:
    return issubclass(kind, Summed)


def moves_light(kind: type[Stage]) -> bool:
    """Return whether a stage moves light over the frame without stating a transfer function."""
    read = {declared.variable for declared in reads_of(kind).values()}
    both = any(declared.variable in read and is_light(declared.dims) for declared in writes_of(kind).values())
    return both and not is_transfer(kind) and not kind.pointwise


@per_kind
def bands_of(kind: type[Stage]) -> str:
    """Return the dim of bands in what a stage reads or writes; '' if there is none."""
    return banded(dim for declared in (*reads_of(kind).values(), *writes_of(kind).values()) for dim in declared.dims)


def is_random(kind: type[Stage]) -> bool:
    """Return whether a stage gets random numbers: new numbers in every cell, or fixed patterns."""
    return "rng" in arguments_of(kind) or bool(patterns_of(kind))


def draws_anew(kind: type[Stage]) -> bool:
    """Return whether the random numbers of a stage depend on the seed; fixed patterns do not."""
    return "rng" in arguments_of(kind)


def decides(stage: Stage) -> bool:
    """Return whether a small change of a stage's input may cause a large change of its output, by design."""
    said = type(stage).decides
    return said if isinstance(said, bool) else any(getattr(stage, name) in values for name, values in said.items())


def rounds(kind: type[Stage]) -> bool:
    """Return whether a stage writes whole numbers in a physical unit, as the codes of a converter."""
    return any(d.dtype != "float" and d.unit != "1" for d in writes_of(kind).values())


def has_no_mean(kind: type[Stage]) -> bool:
    """Return whether a stage draws or rounds without stating its mean output."""
    return (is_random(kind) or rounds(kind)) and not issubclass(kind, Sampled)


@per_kind
def mean_arguments_of(kind: type[Sampled]) -> tuple[str, ...]:
    """Return the argument names of ``mean``. Random numbers are refused, because a mean draws none."""
    names = names_asked(kind, "mean")
    drawn = [name for name in names if name == "rng" or identity_of(name)]
    if drawn:
        raise TypeError(f"{kind.__name__}.mean asks for {', '.join(drawn)}: a mean draws no random numbers")
    return names
