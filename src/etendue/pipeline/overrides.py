"""What is put in the place of a file's words, and the names by which they are meant: ``NAME`` and ``TABLE.NAME`` of a
quantity are one.

In:  a document of a pipeline, overrides such as ``{"NAME": 4, "sweep.TABLE.NAME": [2, 3]}``.
Out: the document changed; overrides and axes by one name each: ``TABLE.NAME`` for a value, the bare name for an axis.
"""

from __future__ import annotations

from etendue.contract import quantities
from etendue.contract.tables import table_in, tables
from etendue.errors import Fault, RequestError, nearest
from etendue.types.documents import Document, DocumentView

TOP = (
    "name",
    "seed",
    "tolerance",
    "norm",
    "leave_out",
    "precision",
    "wanted",
    "keep",
    "stages",
    "sweep",
    "variant",
    "description",
    "requires",
    "most_cells",
    "about",
)


def axis_name(key: str, document: DocumentView) -> str:
    """The name of an axis: a quantity's own, also where it is written ``TABLE.NAME``; a stage may be called as a
    table is.
    """
    head, dot, name = key.partition(".")
    if not dot or head not in tables() or (head in _stages(document) and name not in _quantities(document)):
        return key
    return name


def by_one_name(overrides: DocumentView, document: DocumentView) -> Document:
    """The same overrides by the names under which an archive records them; of two that mean one thing the last
    counts.
    """
    found: Document = {}
    for key, value in overrides.items():
        if key.startswith("sweep."):
            key = f"sweep.{axis_name(key.removeprefix('sweep.'), document)}"
        elif "." not in key and key not in TOP and key in _quantities(document):
            key = table_in(document).place(key)
        elif "." in key and (head := key.partition(".")[0]) in tables() and head not in _stages(document):
            key = table_in(document).place(key.partition(".")[2])
        found.pop(key, None)
        found[key] = value
    return found


def flat(sweep: DocumentView) -> Document:
    """``STAGE.use`` without quotes is a table in a table to TOML; here it is one axis all the same."""
    found: Document = {}
    for key, value in sweep.items():
        if isinstance(value, dict) and value and not set(value) & {"from", "to", "steps", "spacing"}:
            found.update({f"{key}.{name}": one for name, one in value.items()})
        else:
            found[key] = value
    return found


def axes_of(document: DocumentView, faults: list[Fault]) -> Document:
    """The sweep of a document, each axis by its name; a fault where one stands twice."""
    found: Document = {}
    for key, values in flat(document["sweep"]).items() if isinstance(document.get("sweep"), dict) else ():
        name = axis_name(key, document)
        if name in found:
            faults.append(
                Fault(
                    f"sweep.{key}",
                    f"{name} and {table_in(document).place(name)} are one axis, and both are given; leave one of them "
                    f"out",
                )
            )
        found[name] = values
    return found


def apply_overrides(document: Document, overrides: DocumentView, file: str = "") -> list[str]:
    """Put ``TABLE.x``, ``sweep.axis``, ``<stage>.<parameter>`` or a top-level key into the document.

    Returns the places that now hold something else than the file.
    """
    faults: list[Fault] = []
    places = []
    axes = axes_of(document, faults)
    if isinstance(document.get("sweep"), dict) and not faults:
        document["sweep"] = axes
    faults.clear()  # they are found again, with those of the rest of the file
    for key, value in by_one_name(overrides, document).items():
        head, _, tail = key.partition(".")
        named = _stages(document)
        if head in (*tables(), "sweep", "about") and tail:
            if not isinstance(document.setdefault(head, {}), dict):
                continue  # a fault of form, found later
            document[head][tail] = value
            places.append(key)
            if head in tables() and isinstance(document.get("sweep"), dict):
                document["sweep"].pop(tail, None)
        elif tail and head in named:
            number, table = named[head]
            if tail == "use":
                table.setdefault("name", head)  # a swapped stage keeps its name
            table[tail] = value
            places.append(f"stages[{number}].{tail}")
            if isinstance(document.get("sweep"), dict):
                document["sweep"].pop(key, None)
        elif not tail and head in (*TOP, *tables()):
            document[head] = value
            places.append(key)
        else:
            faults.append(Fault(f"--set {key}", f"there is no {head!r} to set{_meant(document, head, tail)}"))
    if faults:
        raise RequestError(faults, file)
    return places


def _meant(document: DocumentView, head: str, tail: str) -> str:
    """What may have been meant by a name that a document has not."""
    if not tail:
        return nearest(head, [*TOP, *_quantities(document)])
    named = _stages(document)
    called = next((name for name, (_, stage) in named.items() if stage.get("use") == head), "")
    if called:
        return f"; the stage {head} is called {called!r} here: {called}.{tail}"
    return nearest(head, [*named, *tables(), "sweep"])


def _quantities(document: DocumentView) -> tuple[str, ...]:
    """What may stand in the table of shared quantities: what distributions declare, and what the document gives."""
    table = table_in(document)
    given = document.get(table.name)
    return (*([table.preset] if table.preset else []), *quantities.names(), *(given if isinstance(given, dict) else ()))


def _stages(document: DocumentView) -> dict[str, tuple[int, Document]]:
    """The stage tables by name, with their numbers."""
    stages = document.get("stages")
    entries = [(n, s) for n, s in enumerate(stages, 1) if isinstance(s, dict)] if isinstance(stages, list) else []
    return {str(s.get("name", s.get("use"))): (n, s) for n, s in entries}
