"""What people are shown first, and what things are called, as distributions say: orders, subjects, words, units.

In:  the name of a place, a subject, a word, a unit.
Out: what is said of it; where nobody says anything, words that fit any graph of stages.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import TypeVar

from etendue.contract.values import quantities
from etendue.errors import PluginError
from etendue.plugins import discovery

WORDS = {
    "cell": "setting",  # a place on the axes of a sweep
    "point": "setting",  # the same, as the head of a page counts it
    "place": "setting",  # and as the title of its opening names it
    "whole": "graph",  # all stages together
    "frame": "frame",  # what takes a picture
    "build": "Choose",  # in front of the axis values of the choice
    "chain": "Each picture is what the stage named below it has made of the one before.",
    "strip": "From stage to stage",
    "curves": "by stage, by name, over a dim of its own",
    "over": "go beyond a limit",  # of more than one cell that is not chosen
    "overs": "goes beyond a limit",  # of one
    "over_what": "",
    "within": "that stay within their limits",
    "lost": "what",  # which stage loses ..., in few words
    "lost_words": "what",
}


@dataclass(frozen=True)
class Subject:
    """What figures may be about. ``said``: what its first figure is called in a sentence; ``short``: at the head of a
    column, '' its own name. ``opens``: whether one of its figures stands open on a page, and may stand against
    another's."""

    said: str = ""
    short: str = ""
    opens: bool = False


@dataclass(frozen=True)
class Unit:
    """``said``: how it is written beside a plot; ``full``: an ordinary full scale, of which stages are tried; ``bits``:
    the shared quantity that says how many digits of two its largest number has; ``noise``: noise says its variance in
    its square."""

    said: str = ""
    full: float = 1.0
    bits: str = ""
    noise: bool = False


_Form = TypeVar("_Form", Subject, Unit)


@cache
def first(place: str) -> tuple[str, ...]:
    """What goes first in a place where there is a choice, of all who say so."""
    found: dict[str, None] = {}
    for brought in discovery.installed().all("first", place):
        if isinstance(brought.value, list | tuple):
            found.update(dict.fromkeys(map(str, brought.value)))
    return tuple(found)


@cache
def words(of: frozenset[str] = frozenset()) -> Mapping[str, str]:
    """What things are called in sentences; with names of distributions, what these say alone: those whose stages a
    graph has.
    """
    every, found = discovery.installed(), dict(WORDS)
    for name in every.names("words"):
        brought = [one for one in every.all("words", name) if not of or one.distribution in of]
        found |= {name: str(brought[0].value)} if brought else {}
    return found


@cache
def spelling() -> Mapping[str, str]:
    """How parts of names are written out; of those that begin with ``_``, how the end of a name is."""
    every = discovery.installed()
    return {name: str(own.value) for name in every.names("spelling") if (own := every.first("spelling", name))}


@cache
def subjects() -> Mapping[str, Subject]:
    """Every subject that is declared, in order."""
    return _all(Subject, "subjects")


@cache
def units() -> Mapping[str, Unit]:
    """What is said of units."""
    return _all(Unit, "scales")


@cache
def _prefixes() -> Mapping[str, str]:
    found = {}
    for name in quantities.names():
        try:
            found[name] = quantities.declared(name).prefix
        except PluginError:  # which whoever uses it is told
            continue
    return {name: prefix for name, prefix in found.items() if prefix}


def prefix(dim: str) -> str:
    """What stands in front of values along a dim, in the place of its name: ``f/`` of an f-number."""
    name = dim.rpartition(".")[2]
    return next((own for quantity, own in _prefixes().items() if name.endswith(quantity)), "")


def prefix_of(key: str) -> str:
    """The same of a shared quantity alone."""
    return _prefixes().get(key, "")


def _all(form: type[_Form], what: str) -> dict[str, _Form]:
    """Whatever is brought and can be read; what cannot be says so in ``etendue stages``."""
    every, found = discovery.installed(), dict[str, _Form]()
    for name in every.names(what):
        if brought := every.first(what, name):
            try:
                found[name] = discovery.made_of(form, f"{what} {name!r}", brought)
            except PluginError:
                continue
    return found
