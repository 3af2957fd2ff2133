"""Variables: their declarations, ``"channel y x [1]"``, and their meaning as distributions declare it.

In:  the text of a port in a stage's ``reads`` or ``writes``; the name of a variable.
Out: name, dims, unit, dtype and whether undefined values are allowed; meaning and how it is shown.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cache

from etendue.plugins import discovery
from etendue.types.documents import DocumentView

_FORM = re.compile(r"^\s*(?:(?P<name>[\w.*]+)\s*:)?\s*(?P<dims>[^\[\]]*?)\s*\[(?P<unit>[^\]]*)\]\s*(?P<flags>.*?)\s*$")
DTYPES = ("float", "uint8", "uint16", "uint32")

NOT_IN_IT = "not_in_it"  # attribute of a metric: stages that affect its subject but are not in it
SHOWN = ("", "linear", "encoded", "unencoded", "map")
COUNTED = ("", "floored", "overexposed")
BETTER = ("", "higher", "lower")


@dataclass(frozen=True)
class Variable:
    """The declaration of a variable by a distribution: meaning, unit, and how a contact sheet shows it.

    ``shown``: '' not at all; ``linear`` light, charge or signal (bands as an eye sees them, a pattern through its own
    filters); ``encoded`` display values, unchanged; ``unencoded`` display values before gamma, shown as they would look
    without it; ``map`` numbers over y and x, in grey. ``white`` is the linear value shown as white; with None, white is
    taken from the bright parts of the first picture. Variables with the same ``scale`` are all shown with the white of
    their last picture. ``black`` names the shared quantity with the value of no signal, ``pattern`` the shared quantity
    with the filters over y and x. ``range`` gives both ends of the scale of a map; with None, the scale ends at the
    smallest and largest value. ``log``: the scale is logarithmic. ``full``: the value to which errors of the variable
    are relative, if that does not follow from its declaration: 1 for a share. ``index``: the values of the variable are
    positions in a list, so a value is either right or wrong; ``names``: the dim whose labels are that list. ``flags``
    names codes, ``masks`` bits that are combined. ``beside``: a dim; the variable is a coordinate of all variables in
    its group with this dim. ``counted``: if the variable is above 0, the end of a run reports that values were raised
    to a floor, or are above saturation. ``better``: whether ``higher`` or ``lower`` is better, '' if it depends.
    ``subject``: the subject of a metric, such as ``detail`` or ``noise``: reports group metrics by subject and open
    with the metric of the lowest ``rank``.

    ``quiet``: the variable is not among the metrics shown first. ``usable``: a cell with a larger value is not chosen
    to open a page. ``instead``: a variable that shows nearly the same; contact sheets with that variable omit this one.
    ``curve``: priority among the curves of a page, the highest first; ``base``: curves of the variable are drawn with a
    line at 0; ``end``: a text; every axis in the unit of the variable ends at the value of the variable, and the text
    is the label of that end. For an index, ``asks`` is the question that it answers, ``said`` gives the names in its
    list as used in sentences, ``tints`` the colours of these names, ``cap`` the name of the factor that limits before
    all others, and ``cap_said`` the text after that name. ``dims``: dims that every stage writing the variable must
    use. ``below_zero``: noise can make the variable negative, and stages that read it must state how they handle
    negative values.
    """

    long_name: str = ""
    units: str = "1"
    shown: str = ""
    white: float | None = None
    scale: str = ""
    black: str = ""
    pattern: str = ""
    range: tuple[float, float] | None = None
    log: bool = False
    counted: str = ""
    full: float | None = None
    index: bool = False
    names: str = ""
    flags: Mapping[str, int] = field(default_factory=dict)
    masks: Mapping[str, int] = field(default_factory=dict)
    beside: str = ""
    better: str = ""
    subject: str = ""
    rank: int = 99
    quiet: bool = False
    usable: float | None = None
    instead: str = ""
    curve: int = 0
    base: bool = False
    end: str = ""
    asks: str = ""
    said: Mapping[str, str] = field(default_factory=dict)
    tints: Mapping[str, str] = field(default_factory=dict)
    cap: str = ""
    cap_said: str = ""
    dims: tuple[str, ...] = ()
    below_zero: bool = False

    def __post_init__(self) -> None:
        for word, allowed in (("counted", COUNTED), ("shown", SHOWN), ("better", BETTER)):
            if (own := vars(self)[word]) not in allowed:
                raise ValueError(f"{word} is {own!r}; allowed: {', '.join(map(repr, allowed))}")
        if self.full is not None and not self.full > 0:
            raise ValueError(f"full is {self.full!r}; allowed: numbers above 0")
        for word, named in (("flags", self.flags), ("masks", self.masks)):
            if not (isinstance(named, Mapping) and all(isinstance(n, str) and n.split() == [n] for n in named)):
                raise ValueError(f"{word} is {named!r}; expected names without blanks and their codes")
        if self.range is not None and not (len(self.range) == 2 and self.range[0] < self.range[1]):
            raise ValueError(f"range is {self.range!r}; expected two numbers, the smaller first")


@cache
def variable(name: str) -> Variable:
    """Return the declaration of a variable; if there is none, a declaration with only its name."""
    brought = discovery.installed().first("variables", name)
    found = discovery.made_of(Variable, f"the variable {name!r}", brought) if brought else Variable()
    return found if found.long_name else replace(found, long_name=name.replace("_", " "))


def without(attrs: DocumentView) -> str:
    """Return the text that follows a metric's name and names the stages that the metric does not include; '' if there
    are none.
    """
    return f", without {attrs[NOT_IN_IT]}" if attrs.get(NOT_IN_IT) else ""


def disagree(name: str) -> str:
    """Return the distributions that declare a variable differently, '' if all agree."""
    brought = discovery.installed().all("variables", name)
    return (
        " and ".join(one.distribution for one in brought)
        if any(one.value != brought[0].value for one in brought)
        else ""
    )


@dataclass(frozen=True)
class Declaration:
    """The declaration of the variable that a port reads or writes.

    ``dims`` are the dims on which a stage works; the engine maps the stage over any leading dims. ``dtype`` is
    ``float`` (the plan's precision) or an unsigned integer type. ``nan`` allows undefined values. An ``optional``
    variable is computed only if it is requested.
    """

    variable: str
    dims: tuple[str, ...]
    unit: str
    dtype: str = "float"
    nan: bool = False
    optional: bool = False

    def __str__(self) -> str:
        flags = "".join(
            f" {flag}"
            for flag in (
                self.dtype if self.dtype != "float" else "",
                "nan" if self.nan else "",
                "optional" if self.optional else "",
            )
            if flag
        )
        return f"{self.variable}: {' '.join(self.dims)} [{self.unit}]{flags}".replace("  ", " ")

    def mapped(self, dims: tuple[str, ...]) -> tuple[str, ...] | None:
        """Return the dims over which a stage is mapped for an input with ``dims``; None if it cannot take
        this input.
        """
        extra = dims[: len(dims) - len(self.dims)]
        return extra if dims == (*extra, *self.dims) and not set(extra) & set(self.dims) else None


def parse_declaration(port: str, text: str) -> Declaration:
    """Parse one declaration; the variable is the port unless the text names one."""
    if text.startswith("*."):  # a probe's look at every stage
        variable, _, rest = text.partition(" ")
        text = f"{variable}: {rest or '[1]'}"
    match = _FORM.match(text)
    if not match:
        raise ValueError(f"cannot read the declaration {port!r}: {text!r}; expected 'dims [unit]'")
    dtype, nan, optional = "float", False, False
    for flag in match["flags"].split():
        if flag == "nan":
            nan = True
        elif flag == "optional":
            optional = True
        elif flag in DTYPES:
            dtype = flag
        else:
            raise ValueError(
                f"unknown flag {flag!r} in the declaration of {port!r}; valid: nan, optional, {', '.join(DTYPES)}"
            )
    return Declaration(match["name"] or port, tuple(match["dims"].split()), match["unit"].strip(), dtype, nan, optional)
