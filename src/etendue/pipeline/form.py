"""Read the entries of a document one by one, in the form that a pipeline needs.

In:  a document.
Out: plain values; for each entry of another form, a fault and the default value.
"""

from __future__ import annotations

from decimal import Decimal
from typing import TypeVar

from etendue.contract.values.names import LONGEST
from etendue.contract.values.units import as_written
from etendue.errors import Fault, nearest, unprintable
from etendue.types.documents import DocumentView

T = TypeVar("T")
ARCHIVE = "archive"  # the table of how results are kept
DIGITS = ("exact", "stated")  # all digits of a result, or those significant at the tolerance


class Words:
    """The entries of one document. ``faults``: the list to which its faults are added."""

    def __init__(self, document: DocumentView, faults: list[Fault]) -> None:
        self.document, self.faults = document, faults

    def refused(self, key: str, value: object, expected: str, default: T) -> T:
        self.faults.append(Fault(key, f"expected {expected}, got {as_written(value)}"))
        return default

    def text(self, key: str, default: str) -> str:
        value = self.document.get(key, default)
        if isinstance(value, str) and (key == "description" or not unprintable(value)):
            return value
        return self.refused(key, value, "text", default)

    def name(self, default: str) -> str:
        """Return the name of the pipeline, which must be valid as a folder name on any system."""
        value = self.document.get("name", default)
        if isinstance(value, str) and _plain(value):
            return value
        ways = f"at most {LONGEST} characters, no slash, no control characters, no leading dot"
        self.faults.append(Fault("name", f"expected a plain name, got {as_written(value)}; {ways}"))
        return default

    def names(self, key: str) -> tuple[str, ...] | None:
        value = self.document.get(key)
        if value is None or (key == "keep" and value == "all"):
            return None
        listed = [value] if isinstance(value, str) else value
        if isinstance(listed, list) and all(isinstance(one, str) for one in listed):
            return tuple(listed)
        what = 'distributions, such as ["etendue-mine"]' if key == "requires" else "variables"
        return self.refused(key, value, f"a list of {what}", None)

    def whole(self, key: str, default: int, least: int) -> int:
        value = self.document.get(key, default)
        if isinstance(value, int) and not isinstance(value, bool) and value >= least:
            return value
        return self.refused(key, value, f"a whole number of at least {least}", default)

    def share(self, key: str, default: float) -> float:
        value = self.document.get(key, default)
        fits = isinstance(value, int | float | Decimal) and not isinstance(value, bool) and 0 <= float(value) < 1
        return float(value if fits else self.refused(key, value, "a number of at least 0 and below 1", default))

    def flag(self, key: str, default: bool) -> bool:
        value = self.document.get(key, default)
        return value if isinstance(value, bool) else self.refused(key, value, "true or false", default)

    def choice(self, key: str, among: tuple[str, ...]) -> str:
        """Return the value of a key that must be one of some words; by default the first word."""
        value = self.text(key, among[0])
        if value not in among:
            self.faults.append(Fault(key, f"{value!r} is not a {key}{nearest(value, among)}; must be {_listed(among)}"))
        return value

    def digits(self, tolerance: float) -> str:
        """Return the value of ``digits`` in the table ``[archive]``."""
        place = f"{ARCHIVE}.digits"
        own = Words({f"{ARCHIVE}.{key}": value for key, value in self.table(ARCHIVE).items()}, self.faults)
        self.faults += [
            Fault(key, f"unknown key; the only key of [{ARCHIVE}] is digits") for key in own.document if key != place
        ]
        digits = own.text(place, DIGITS[0])
        if digits not in DIGITS:
            self.faults.append(Fault(place, f"{digits!r}: expected {_listed(DIGITS)}{nearest(digits, DIGITS)}"))
        elif digits != DIGITS[0] and not tolerance > 0:
            why = "rounds results to a share of the tolerance, which is 0"
            self.faults.append(Fault(place, f"{digits!r} {why}; set a tolerance above 0, or digits = {DIGITS[0]!r}"))
        return digits

    def table(self, key: str) -> DocumentView:
        value = self.document.get(key, {})
        return value if isinstance(value, dict) else self.refused(key, value, "a table", {})


def _listed(words: tuple[str, ...]) -> str:
    return f"{', '.join(words[:-1])} or {words[-1]}"


def _plain(name: str) -> bool:
    return (
        bool(name)
        and len(name.encode()) <= LONGEST
        and name[0] not in ".-"
        and not set(name) & set("/\\")
        and not unprintable(name)
    )
