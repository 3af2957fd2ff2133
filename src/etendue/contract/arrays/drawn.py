"""The properties with which an array is drawn as a picture: how it is shown, its white and black levels, its filters,
and the white to which its viewer is adapted.

In:  the declaration of a variable; attributes of an array.
Out: ``Drawn``, and the attributes that describe it for a program without a plan.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

from etendue.contract.arrays.colouring import flat_dims
from etendue.contract.arrays.variables import Variable, variable
from etendue.types.documents import AxisValues, Document, DocumentView

BY = "drawn_by"  # attributes that hold only at some axis values, as JSON: [[{dim: value}, {attribute: value}], ...]


@dataclass(frozen=True)
class Drawn:
    """``shown`` and ``white`` to ``log`` have the meaning that they have in ``contract.arrays.variables.Variable``.

    ``pattern``: rows of filters on the pixels, '' for none; ``viewer``: XYZ of the white to which the viewer is
    adapted, () for the white of the display.
    """

    shown: str
    white: float | None = None
    scale: str = ""
    range: tuple[float, float] | None = None
    log: bool = False
    black: float = 0.0
    pattern: str = ""
    viewer: tuple[float, ...] = ()

    @classmethod
    def of(cls, known: Variable, black: float = 0.0, pattern: str = "", viewer: Sequence[float] = ()) -> Drawn:
        return cls(known.shown, known.white, known.scale, known.range, known.log, black, pattern, tuple(viewer))

    @property
    def linear(self) -> bool:
        """Whether the array is light or a signal, which must be encoded for the screen."""
        return self.shown == "linear"

    @property
    def sent(self) -> bool:
        """Whether the values, between 0 and 1, go to the screen unchanged."""
        return self.shown in ("encoded", "unencoded")

    @property
    def scaled(self) -> bool:
        """Whether the value shown as white is taken from the picture, because none is declared."""
        return self.linear and self.white is None

    def attributes(self) -> Document:
        """Return the attributes for an archive; values that are the default are omitted."""
        found = {
            "drawn_white": self.white,
            "drawn_scale": self.scale,
            "drawn_range": list(self.range or ()),
            "drawn_log": int(self.log),
            "drawn_black": self.black,
            "drawn_pattern": self.pattern,
            "drawn_for": list(self.viewer),
        }
        return {"drawn_as": self.shown} | {name: value for name, value in found.items() if value}


def read(name: str, attrs: DocumentView, at: AxisValues) -> Drawn:
    """Return how to draw an array, from its attributes at a place on the axes or, if it has no such attributes, from
    its name."""
    if "drawn_as" not in attrs:
        return Drawn.of(variable(name))
    own = dict(attrs)
    for place, more in json.loads(str(attrs.get(BY, "[]"))):
        if all(at.get(dim) == value for dim, value in place.items()):
            own |= more
    white, ends = own.get("drawn_white"), own.get("drawn_range")
    return Drawn(
        str(own["drawn_as"]),
        None if white is None else float(white),
        str(own.get("drawn_scale", "")),
        (float(ends[0]), float(ends[1])) if ends is not None and len(ends) == 2 else None,
        bool(own.get("drawn_log")),
        float(own.get("drawn_black", 0.0)),
        str(own.get("drawn_pattern", "")),
        tuple(float(one) for one in own.get("drawn_for", ())),
    )


class Pictured(NamedTuple):
    """A picture of a cell: its variable, its own dims, how it is drawn, and the sweep axes that affect it."""

    variable: str
    dims: tuple[str, ...]
    drawn: Drawn
    axes: tuple[str, ...]

    @property
    def frames(self) -> tuple[str, ...]:
        """The dims of which a picture shows one entry; each frame, and their merged picture, has its own exposure."""
        return tuple(dim for dim in self.dims if dim not in ("y", "x", *flat_dims()))


def lit_by(pictures: Sequence[Pictured], number: int) -> int:
    """Return the number of the picture that sets the brightness scale of picture ``number`` of the same cell; the
    pictures are in the order in which light passes the stages.

    It is the first picture of the same variable, so that a picture that gets darker looks darker. For variables that
    share a scale it is the last picture, because values beyond a full well are not brightness. Only pictures with the
    same frames and no further axes count, so that a picture looks the same wherever it is drawn.
    """
    own = pictures[number]
    able = [n for n, one in enumerate(pictures) if set(one.axes) <= set(own.axes) and one.frames == own.frames]
    if own.drawn.scale:
        return max(n for n in able if pictures[n].drawn.scale == own.drawn.scale)
    return next(n for n in able if pictures[n].variable == own.variable)
