"""What a stage can do beyond ``run``: typed bases, asked for by ``issubclass``.

In:  a class of stages.
Out: whether it is a source, a transfer function, made by band, may be left out, looks at other stages.

Any stage may read ``"*.transfer [1]"``: its port is given the transfer functions of all stages in front of it, see
``Probe``.
"""

from __future__ import annotations

import dataclasses
import inspect
import math
from abc import abstractmethod
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, ClassVar

from etendue.contract.dims import banded, is_light
from etendue.contract.facts import Facts
from etendue.contract.grid import Bands, Grid, Labels, Line
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
    """A stage that reads nothing and says before any array what it will write."""

    @abstractmethod
    def describe(self) -> tuple[Facts, Mapping[str, Grid]]: ...

    def white_light(self, edges: tuple[float, ...]) -> Array | None:
        """(band,): light of a white surface in bands with these edges, of any scale, by which figures weigh them; None:
        not known, and they take light that is equally strong in all bands."""
        return None


@dataclasses.dataclass(frozen=True, kw_only=True)
class Tinting(Stage):
    """A stage that takes light by band, the same all over the frame, as a filter does."""

    @abstractmethod
    def transmission(self, grid: Grid) -> Array:
        """(band,): of the bands of a grid."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Transfer(Stage):
    """A linear shift-invariant stage: a transfer function in the place of ``run``. ``radial``: it depends on the size
    of the frequency alone. It reads and writes one variable."""

    radial: ClassVar[bool] = False

    @abstractmethod
    def transfer(self, *given: Any, **named: Any) -> Array:
        """At separable frequencies: ``(fy, fx, middles of the bands)``, cycles/um and the unit in which their dim is
        asked, and ``prepared`` where ``prepare`` gives something."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Summed(Transfer):
    """A transfer function that ends in a weighted sum over the bands, as a pixel behind its filters does."""

    @abstractmethod
    def weights(self, prepared: Any) -> Array:
        """(channel, band)."""

    def segment_error(
        self, before: tuple[Transfer, ...], facts: Any, grid: Mapping[str, Grid], precision: str
    ) -> tuple[float | None, str]:
        """Its error behind the stages that are joined before it."""
        return self.error(facts, grid, precision)

    def terms(self) -> int:
        """Of an expansion of the sum, taken before the transfer functions; 0: every band has its own."""
        return 0

    def kept(self) -> float:
        """Share of the grid's Nyquist frequency beyond which the light in front of it is left out; 1: nothing is."""
        return 1.0


@dataclasses.dataclass(frozen=True, kw_only=True)
class ChannelTransfer(Stage):
    """A stage behind the sum over bands that moves charge from pixel to pixel, whatever their filters are: linear, and
    over the pixels of a channel shift-invariant on average. Whoever looks at transfer functions sees it with those of
    the pixel.
    """

    @abstractmethod
    def channel_transfer(self, fy: Array, fx: Array, light: Array, prepared: Any) -> Array:
        """(channel that collects, channel of the filter, m, n) at fy (m,), fx (n,), cycles/um.

        ``light``: (band,), of a white surface, of any scale.
        """

    def moves_charge(self) -> bool:
        """Whether it does anything with these parameters."""
        return True


@dataclasses.dataclass(frozen=True, kw_only=True)
class Banded(Stage):
    """A stage whose ``run`` may be given some of the bands."""

    @abstractmethod
    def by_band(self, prepared: Any, bands: slice) -> Any:
        """What is prepared for these bands."""

    def constants(self, prepared: Any) -> Mapping[str, Array]:
        """Of a source: what it writes that has no place."""
        return {}


@dataclasses.dataclass(frozen=True, kw_only=True)
class Haloed(Stage):
    """A stage of which every row follows from the rows near it: ``run`` may be given some rows of a frame, and gives
    them the same bits.

    What it reads with rows, and ``y`` and its like, is cut; all else (tables, figures) is whole. Random numbers must be
    asked for once, in the order of the rows, and only without a halo. Strips begin on even rows, and hold as many rows
    as the halo has at least.
    """

    def halo(self) -> int | None:
        """Rows above and below that a row depends on; None: with these parameters on the whole frame."""
        return 0

    def joined(self, parts: Mapping[str, Sequence[Array]], sizes: Sequence[int]) -> Mapping[str, Array]:
        """What is written without rows, from what was given for each strip; ``sizes``: values of a strip's first
        variable. The same for all strips, unless a stage without a halo says otherwise."""
        apart = [name for name, values in parts.items() if any(not _equal(values[0], value) for value in values[1:])]
        if apart:
            raise ValueError(
                f"{type(self).__name__} gives some rows another {', '.join(apart)} than others: write joined()"
            )
        return {name: values[0] for name, values in parts.items()}


@dataclasses.dataclass(frozen=True, kw_only=True)
class Bounded(Stage):
    """A stage that may be left out where it does little: it reads and writes the same variable on the same grid."""

    @abstractmethod
    def negligible(self, facts: Facts, grid: Grid) -> tuple[float, str] | None:
        """How wrong leaving it out is, relative to full scale, and why; None where that is not known."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Sampled(Stage):
    """A stage that draws random numbers or rounds, and knows what it writes on average.

    Errors of a pipeline are found by comparing expected values: an error d in front of rounding by q is sqrt(d q)
    behind it, and two draws differ by their noise.
    """

    @abstractmethod
    def mean(self, *given: Any, **named: Any) -> Mapping[str, Array]:
        """What ``run`` gives on average, before rounding: the same variables, as floats. It asks by name for what
        ``run`` may ask for, random numbers aside."""


class Noisy(Stage):
    """A stage that adds noise to the level of a place, and knows how much.

    ``by_line``: whole rows or columns share the noise. ``inherent``: it follows from the level alone, as counts
    scatter, so that who counts noise knows it without a datasheet. Rounding is noise too: a twelfth of the square of
    its step.
    """

    by_line: ClassVar[bool] = False
    inherent: ClassVar[bool] = False

    @abstractmethod
    def variance(self, level: float) -> float:
        """What is added to the variance of a place with a mean level, in the square of its unit."""


class Datasheet(Stage):
    """A stage that knows figures of itself which a measurement finds again, and at which others may look."""

    @abstractmethod
    def datasheet(self) -> Mapping[str, float]:
        """Figures by name: those that whoever looks at them knows."""


@dataclasses.dataclass(frozen=True)
class Sheet:
    """What a port that looks at ``"*.datasheet"`` is given of a stage: its role and its figures; none of one that
    has no datasheet.
    """

    role: str
    figures: Mapping[str, float]

    @classmethod
    def of(cls, stage: Stage) -> Sheet:
        return cls(stage.role, dict(stage.datasheet()) if isinstance(stage, Datasheet) else {})


@dataclasses.dataclass(frozen=True, kw_only=True)
class Probe(Stage):
    """A stage that looks at all stages in order: reads ``"*.transfer"`` or ``"*.<variable>"``.

    ``run`` gets, for each such port, a list of (stage name, what it looks at): the transfer function up to and
    including that stage (``etendue.compute.joined.otf.Otf``), or the array itself; with ``with_grids`` arrays come as
    (stage name, array, grid). Nothing reads from a probe. It may write the dim ``stage``: every stage it looks at, in
    order, whose names ``run`` may ask for as ``stage``; those seen through the ports in ``beside`` alone have no place
    in it, and a ``ChannelTransfer`` shares the pixel's.
    """

    with_grids: ClassVar[bool] = False
    beside: ClassVar[tuple[str, ...]] = ()


@dataclasses.dataclass(frozen=True, kw_only=True)
class Viewed(Stage):
    """A stage whose pictures are meant for an eye that is adapted to a white of their own."""

    @abstractmethod
    def viewing_white(self) -> Array | None:
        """XYZ of that white, or None where it is the display's."""


CAPABILITIES = {
    "describe": Source,
    "transfer": Transfer,
    "weights": Summed,
    "channel_transfer": ChannelTransfer,
    "by_band": Banded,
    "negligible": Bounded,
    "viewing_white": Viewed,
    "mean": Sampled,
    "halo": Haloed,
    "joined": Haloed,
}


def no_coordinates(kind: type[Stage]) -> str:
    """What ``creates`` should be in place of what it is, '' where it is right: a list of names or numbers becomes
    Labels.
    """
    creates: Any = kind.creates
    given = creates.items() if isinstance(creates, Mapping) else ()
    wrong = [(dim, one) for dim, one in given if not isinstance(one, Line | Bands | Labels)]
    if isinstance(creates, Mapping) and not wrong:
        return ""
    said = f"{kind.__name__}.creates is {creates!r}; expected"
    for dim, one in wrong:
        if isinstance(one, list | tuple) and all(isinstance(entry, str | int | float) for entry in one):
            return f"{said} a coordinate for {dim!r}: Labels({tuple(one)!r}), from etendue.api import Labels"
    return (
        f"{said} dims and their coordinates, such as {{'channel': RGB}} or {{'angle': Labels((0.0, 90.0), 'deg')}}, "
        f"of etendue.api"
    )


def check_class(kind: type[Stage]) -> None:
    """What a class says of itself beside its ports, held against the form that the engine reads; ``TypeError`` where
    it is another.
    """
    _check_words(kind)
    _check_methods(kind)
    name, rate, working = kind.__name__, kind.nanoseconds, kind.working
    if not _is_number(rate) or not rate > 0:
        raise TypeError(f"{name}.nanoseconds is {rate!r}; expected a number above 0")
    if not _is_number(working) or not 0 <= working < math.inf:
        raise TypeError(f"{name}.working is {working!r}; expected a number from 0")
    if issubclass(kind, Sampled):
        mean_arguments_of(kind)
    own_methods = [method for method, base in CAPABILITIES.items() if issubclass(kind, base)]
    for attribute in ("run", "grid", "carry", "error", "prepare", "warn", "warn_among", "assumes", *own_methods):
        own = inspect.getattr_static(kind, attribute, None)
        if own is not None and not callable(own):
            raise TypeError(f"{name}.{attribute} is {own!r}; expected a method")


def _check_words(kind: type[Stage]) -> None:
    """How it takes what is undefined or negative, what it keeps, which libraries and dims are its own."""
    name, gain = kind.__name__, kind.gain
    if gain is not None and not (_is_number(gain) and 0 <= gain < math.inf):
        raise TypeError(f"{name}.gain is {gain!r}; allowed are None and finite numbers from 0")
    said = (("nan", kind.nan, ("error", "keep")), ("negative", kind.negative, ("error", "keep", "clip")))
    for attribute, word, allowed in said:
        if word not in allowed:
            raise TypeError(f"{name}.{attribute} is {word!r}; allowed are {', '.join(map(repr, allowed))}")
    if isinstance(kind.keeps, str) or not set(kind.keeps) <= {"order", "sum"}:
        raise TypeError(f"{name}.keeps is {kind.keeps!r}; expected some of 'order' and 'sum', such as ('order',)")
    if isinstance(kind.libraries, str) or not all(isinstance(text, str) for text in kind.libraries):
        raise TypeError(f"{name}.libraries is {kind.libraries!r}; expected names of distributions, such as ('scipy',)")
    if wrong := no_coordinates(kind):
        raise TypeError(wrong)


def _check_methods(kind: type[Stage]) -> None:
    """What it computes with is there, and of the bases that ask for it."""
    methods = {name: own for name in dir(kind) if inspect.isfunction(own := inspect.getattr_static(kind, name))}
    for method, base in CAPABILITIES.items():
        if method in methods and not issubclass(kind, base):
            raise TypeError(
                f"{kind.__name__} has {method}, as a {base.__name__} has, and is none: derive it from "
                f"etendue.api.{base.__name__}"
            )
    lacking = sorted(name for name, own in methods.items() if vars(own).get("__isabstractmethod__"))
    if lacking:
        raise TypeError(f"{kind.__name__} has no {', '.join(lacking)}, which its bases ask for")
    if kind.run is None and not is_transfer(kind):
        raise TypeError(f"{kind.__name__} has neither run nor transfer: nothing would be computed")


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def is_source(kind: type[Stage]) -> bool:
    return issubclass(kind, Source)


def is_transfer(kind: type[Stage]) -> bool:
    return issubclass(kind, Transfer)


def _equal(one: Array, other: Array) -> bool:
    """Whether two plain figures are the same; what is undefined equals itself."""
    same = (one == other) | ((one != one) & (other != other))
    return bool(same.all() if hasattr(same, "all") else same)


def halo_of(stage: Stage) -> int | None:
    """Rows above and below that a row of what a stage writes depends on; None: on the whole frame, as far as is
    known.
    """
    kind = type(stage)
    if isinstance(stage, Haloed):
        rows = stage.halo()
        if rows is not None and (isinstance(rows, bool) or not isinstance(rows, int) or rows < 0):
            raise TypeError(f"{kind.__name__}.halo gives {rows!r}; expected a whole number of rows from 0, or None")
        return None if rows and is_random(kind) else rows
    return 0 if kind.elementwise and not is_random(kind) else None


def is_seen_as_transfer(kind: type[Stage]) -> bool:
    """Whether who looks at transfer functions looks at it: as one of them, or with the pixel in front of it."""
    return issubclass(kind, Transfer | ChannelTransfer)


def ends_in_sum(kind: type[Stage]) -> bool:
    return issubclass(kind, Summed)


def moves_light(kind: type[Stage]) -> bool:
    """Whether a stage changes the place of light by band, and no transfer function says how."""
    read = {declared.variable for declared in reads_of(kind).values()}
    both = any(declared.variable in read and is_light(declared.dims) for declared in writes_of(kind).values())
    return both and not is_transfer(kind) and not kind.pointwise


@per_kind
def bands_of(kind: type[Stage]) -> str:
    """The dim of bands that a stage speaks of in what it reads or writes; '' where it speaks of none."""
    return banded(dim for declared in (*reads_of(kind).values(), *writes_of(kind).values()) for dim in declared.dims)


def is_random(kind: type[Stage]) -> bool:
    """Whether a stage is given random numbers: new in every cell, or fixed patterns."""
    return "rng" in arguments_of(kind) or bool(patterns_of(kind))


def draws_anew(kind: type[Stage]) -> bool:
    """Whether its random numbers follow the seed: fixed patterns alone do not."""
    return "rng" in arguments_of(kind)


def rounds(kind: type[Stage]) -> bool:
    """Whether a stage writes whole numbers of a physical unit: codes of a converter."""
    return any(d.dtype != "float" and d.unit != "1" for d in writes_of(kind).values())


def has_no_mean(kind: type[Stage]) -> bool:
    """Whether a stage draws or rounds and does not say what comes of it on average."""
    return (is_random(kind) or rounds(kind)) and not issubclass(kind, Sampled)


@per_kind
def mean_arguments_of(kind: type[Sampled]) -> tuple[str, ...]:
    """The names that ``mean`` asks for. Random numbers are refused: there is nothing to draw."""
    names = names_asked(kind, "mean")
    drawn = [name for name in names if name == "rng" or identity_of(name)]
    if drawn:
        raise TypeError(f"{kind.__name__}.mean asks for {', '.join(drawn)}: a mean draws nothing")
    return names
