"""The error of the answer as text: printed after a value, and notes about the cells where it was measured.

In:  stored errors (``AnswerErrors.document()``), or one such error.
Out: texts for the end table, captions and the report.
"""

from __future__ import annotations

import math
from typing import Any

from etendue.telling import human_seconds
from etendue.types.documents import DocumentView

MATTERS = 0.02  # of the total: smaller parts are not listed
LONGEST = 300  # characters of a text in a stored document
NOISE = "noise"  # key in ``open`` of the noise of one draw
OMITTED = "omissions"  # the only part of an error that is not from a discretisation
TEXTS, NUMBERS = ("stage", "variable", "unit"), ("rms", "max")


def shortened(text: str) -> str:
    """Return the first line of a message, short enough to be stored."""
    line = text.partition("\n")[0]
    return line if len(line) <= LONGEST - 20 else f"{line[: LONGEST - 20]}..."


def is_sound(document: Any) -> bool:
    """Return whether a stored document has the form of ``AnswerErrors.document()``: it may have been edited."""
    if not isinstance(document, dict) or not isinstance(document.get("at"), dict):
        return False
    remedies, why = document.get("remedies", {}), document.get("why", "")
    if not isinstance(remedies, dict) or not isinstance(why, str) or not all(map(_is_place, document["at"].values())):
        return False
    numbers = [document.get(name) for name in ("points", "seconds", "dear", "budget")]
    texts = [text for pair in remedies.items() for text in pair]
    if not all(isinstance(text, str) and len(text) <= LONGEST for text in texts):
        return False
    errors, shown = document.get("errors"), document.get("shown")
    if not all(_is_number(one) for one in numbers) or not isinstance(errors, dict) or not isinstance(shown, dict):
        return False
    return all(_is_sound_error(one) for own in (errors, shown) for one in own.values())


def _is_place(value: Any) -> bool:
    """Return whether an axis may have this value: a scalar, or a list of scalars."""
    return not any(isinstance(one, list | dict) for one in (value if isinstance(value, list) else [value]))


def _is_sound_error(error: Any) -> bool:
    if not isinstance(error, dict) or not all(isinstance(error.get(n), dict) for n in ("parts", "fixed", "open")):
        return False
    texts = [error.get(name) for name in TEXTS] + [*error["parts"]]
    texts += [text for own in (error["fixed"], error["open"]) for pair in own.items() for text in pair]
    parts = error["parts"].values()
    if not all(isinstance(part, dict) and isinstance(part.get("basis"), str) for part in parts):
        return False
    numbers = [part.get(name) for part in (*parts, error) for name in NUMBERS] + [error.get("noise")]
    return all(isinstance(text, str) and len(text) <= LONGEST for text in texts) and (
        all(one is None or _is_number(one) for one in numbers)
        and all(_is_number(error.get(name)) for name in ("points", "scaled"))
    )


def _is_number(value: Any) -> bool:
    if isinstance(value, bool) or not isinstance(value, int | float):
        return value in ("inf", "-inf")
    return isinstance(value, float) or abs(value) < 1e15


def unknown_parts(error: DocumentView) -> list[str]:
    """Return the parts of an error that were not measured. The interval of the noise is given separately and is not a
    part of the error.
    """
    return [name for name in error["open"] if name != NOISE]


def size(error: DocumentView) -> float:
    """Return the error of a variable: the largest error if it consists of numbers, the rms error if it is a picture or
    a curve.
    """
    return number(error[_norm(error)])


def _norm(error: DocumentView) -> str:
    return "max" if error["unit"] and error.get("max") is not None else "rms"


def _shares(error: DocumentView) -> list[tuple[float, str]]:
    """Return (size, name) of the parts that matter in an error, largest first."""
    norm = _norm(error)
    own = sorted(((number(part[norm]), name) for name, part in error["parts"].items()), reverse=True)
    return [(value, name) for value, name in own if value > MATTERS * size(error)]


def parts_text(error: DocumentView, missing: bool = True) -> str:
    """Return the parts that matter in an error as text, largest first: ``bins 0.02, spacing 0.01``; then the parts that
    were not measured.
    """
    known = ", ".join(f"{name} {value:.2g}" for value, name in _shares(error))
    more = ", ".join(unknown_parts(error)) if missing else ""
    return "; ".join(text for text in (known, f"{more} not measured" if more else "") if text)


def says_enough(error: DocumentView, complete: bool = False) -> bool:
    """Return whether an error may be shown: all its parts were measured or, if ``complete`` is False, the part of at
    least one relevant discretisation.
    """
    unknown = unknown_parts(error)
    if unknown and not complete:
        return any(
            name != OMITTED and part["basis"] == "refined" and part["rms"] for name, part in error["parts"].items()
        )
    return bool(error["parts"]) and not unknown


def plus_minus(error: DocumentView | None, unit: str = "") -> str:
    """Return the text printed after a value: ``\u00b10.03 cycles/mm (bins 0.02, spacing 0.01)``; '' if not
    enough was measured.
    """
    if error is None or not says_enough(error):
        return ""
    inside, own = parts_text(error), unit if unit != "1" else ""
    noise = f" \u00b1{number(error['noise']):.1g} (noise)" if error.get("noise") else ""
    if unknown_parts(error):
        return f"{own} (error at least {size(error):.2g}: {inside}, --measure does){noise}".lstrip()
    if not size(error):
        return f"{own} (no numerical error){noise}".lstrip()
    shown = f"\u00b1{size(error):.2g} {own}".rstrip()
    return f"{shown}{f' ({inside})' if inside else ''}{noise}"


def number(value: Any) -> float:
    """Return a stored number, which may be None or a text."""
    return math.nan if value is None else float(value)


def remedies(document: DocumentView, command: str = "") -> list[str]:
    """Return a line with the settings that reduce the errors, the most effective first; an empty list if no setting
    reduces a part that matters. ``command``: the command to which the settings are added.
    """
    effect: dict[str, float] = {}
    for one in document.get("errors", {}).values():
        if says_enough(one):
            for value, name in _shares(one):
                effect[name] = max(effect.get(name, 0.0), value / size(one))
    own = {name: text for name, text in document.get("remedies", {}).items() if effect.get(name)}
    ranked = sorted(own, key=lambda name: -effect[name])
    settings = " ".join(f"--set {one}" for name in ranked for one in own[name].replace(" = ", "=").split(", "))
    few = f"{', '.join(ranked)}{'; use one or more; the first has the largest effect' if len(ranked) > 1 else ''}"
    return [f"for smaller errors: {command} {settings} ({few})".replace(":  ", ": ")] if ranked else []


def notes(document: DocumentView, remedied: bool = False) -> list[str]:
    """Return notes: where the errors were measured, which were not, and the time or the option needed to measure these.
    ``remedied``: whether another line already gives the settings for smaller errors.
    """
    if document.get("why"):
        return [f"error of the answer not measured: {document['why']}"]
    errors, points = document["errors"].values(), document["points"]
    factor = max((number(one["scaled"]) for one in errors), default=1.0)
    where = "" if points == 1 and factor == 1 else f" at {points} point{'s' if points > 1 else ''} of the sweep"
    spread = f"; for all points, {factor:g} times the measured errors are stated" if factor > 1 else ""
    when = "by an earlier run" if document["remembered"] else f"in {human_seconds(number(document['seconds']))}"
    said = [f"measured{where} without noise, {when}{spread}"] if any(says_enough(one) for one in errors) else []
    fixed = {f"{name}: {why}" for one in errors for name, why in one["fixed"].items()}
    said += [f"not included in these errors, because it cannot be refined: {text}" for text in sorted(fixed)]
    return said + (remedies(document) if said and not remedied else []) + _missing(document)


def _missing(document: DocumentView) -> list[str]:
    """Return texts that name the parts that were not measured, because they are too costly or for another reason."""
    costly: dict[str, None] = {}
    whose: dict[str, None] = {}
    others: dict[tuple[str, str], list[str]] = {}
    for one in document["errors"].values():
        for name, why in one["open"].items():
            if "costs about" in why:
                costly |= dict.fromkeys(name.split(" and "))
                whose[one["variable"]] = None
            else:
                others.setdefault((name, why), []).append(one["variable"])
    seconds = human_seconds(number(document["dear"]))
    of = f" for {_few(list(whose))}" if len(whose) < len(document["errors"]) else ""
    time = f", in about {seconds}" if number(document["dear"]) >= 1e-3 else ""
    said = [f"not measured: {', '.join(costly)}{of}; --measure does{time}"] if costly else []
    return said + [f"not measured for {_few(names)} ({part}): {why}" for (part, why), names in others.items()]


def _few(names: list[str]) -> str:
    return ", ".join(names[:3]) + (f" and {len(names) - 3} more" if len(names) > 3 else "")
