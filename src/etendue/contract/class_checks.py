"""Check the form of a class of stages: its attributes, its methods and the typed bases that these need.

In:  a class of stages.
Out: a ``TypeError`` that says what the engine does not accept. Ports are checked with the pipeline.
"""

from __future__ import annotations

import inspect
import math
from collections.abc import Mapping
from typing import Any

from etendue.contract.arrays.grid import Bands, Labels, Line
from etendue.contract.capabilities import (
    Banded,
    Bounded,
    ChannelTransfer,
    Haloed,
    Sampled,
    Source,
    Summed,
    Transfer,
    Viewed,
    is_transfer,
    mean_arguments_of,
)
from etendue.contract.discretised import Discretised
from etendue.contract.stage import Stage

CAPABILITIES = {
    "describe": Source,
    "transfer": Transfer,
    "weights": Summed,
    "channel_transfer": ChannelTransfer,
    "by_band": Banded,
    "negligible": Bounded,
    "viewing_white": Viewed,
    "discretisations": Discretised,
    "refined": Discretised,
    "mean": Sampled,
    "halo": Haloed,
    "joined": Haloed,
}


def no_coordinates(kind: type[Stage]) -> str:
    """Return a text that states the correct form of ``creates``; '' if its form is correct. For a list of names or
    numbers, the text suggests ``Labels``.
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
    return f"{said} dims and coordinates, such as {{'channel': RGB}} or {{'angle': Labels((0.0, 90.0), 'deg')}}"


METHODS = ("run", "grid", "carry", "growth", "error", "prepare", "warn", "warn_among", "assumes")  # of every stage


def check_class(kind: type[Stage]) -> None:
    """Check the attributes and methods of a class except its ports; raise ``TypeError`` if one has a form that the
    engine does not accept.
    """
    _check_words(kind)
    _check_methods(kind)
    name, rate, working = kind.__name__, kind.nanoseconds, kind.working
    if not _is_number(rate) or not rate > 0:
        raise TypeError(f"{name}.nanoseconds is {rate!r}; expected a number greater than 0")
    if not _is_number(working) or not 0 <= working < math.inf:
        raise TypeError(f"{name}.working is {working!r}; expected a number of at least 0")
    if issubclass(kind, Sampled):
        mean_arguments_of(kind)
    for attribute in (*METHODS, *(method for method, base in CAPABILITIES.items() if issubclass(kind, base))):
        own = inspect.getattr_static(kind, attribute, None)
        if own is not None and not callable(own):
            raise TypeError(f"{name}.{attribute} is {own!r}; expected a method")


def _check_words(kind: type[Stage]) -> None:
    """Check the declarations of a stage about undefined and negative values, preserved properties, libraries
    and dims.
    """
    name, gain = kind.__name__, kind.gain
    if gain is not None and not (_is_number(gain) and 0 <= gain < math.inf):
        raise TypeError(f"{name}.gain is {gain!r}; allowed: None and finite numbers of at least 0")
    said = (("nan", kind.nan, ("error", "keep")), ("negative", kind.negative, ("error", "keep", "clip")))
    for attribute, word, allowed in said:
        if word not in allowed:
            raise TypeError(f"{name}.{attribute} is {word!r}; allowed: {', '.join(map(repr, allowed))}")
    if isinstance(kind.keeps, str) or not set(kind.keeps) <= {"order", "sum"}:
        raise TypeError(f"{name}.keeps is {kind.keeps!r}; expected some of 'order' and 'sum', such as ('order',)")
    if isinstance(kind.libraries, str) or not all(isinstance(text, str) for text in kind.libraries):
        raise TypeError(f"{name}.libraries is {kind.libraries!r}; expected names of distributions, such as ('scipy',)")
    if wrong := no_coordinates(kind):
        raise TypeError(wrong)


def _check_methods(kind: type[Stage]) -> None:
    """Check that methods come with their base classes, and that abstract methods are defined."""
    methods = {name: own for name in dir(kind) if inspect.isfunction(own := inspect.getattr_static(kind, name))}
    for method, base in CAPABILITIES.items():
        if method in methods and not issubclass(kind, base):
            raise TypeError(
                f"{kind.__name__} defines {method}, a method of {base.__name__}, from which it is not derived: derive "
                f"it from etendue.api.{base.__name__}"
            )
    lacking = sorted(name for name, own in methods.items() if vars(own).get("__isabstractmethod__"))
    if lacking:
        raise TypeError(f"{kind.__name__} lacks {', '.join(lacking)}, required by its base classes")
    if kind.run is None and not is_transfer(kind):
        raise TypeError(f"{kind.__name__} has neither run nor transfer; define one of them")


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)
