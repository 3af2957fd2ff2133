"""Override the values of a file, and resolve the names by which they are given: ``NAME`` and ``TABLE.NAME`` are the
same quantity.

In:  a document of a pipeline, overrides such as ``{"NAME": 4, "sweep.TABLE.NAME": [2, 3]}``.
Out: the document changed; overrides and axes each under one name: ``TABLE.NAME`` for a value, the bare name for an
axis.
"""

from __future__ import annotations

from etendue.contract.values import quantities
from etendue.contract.values.tables import SHARED, table_in, tables
from etendue.errors import Fault, RequestError, nearest
from etendue.pipeline.form import ARCHIVE
from etendue.pipeline.zipped import is_axis
from etendue.types.documents import Document, DocumentView

TOP = (
    "name",
    "seed",
    "tolerance",
    "norm",
    "leave_out",
    "stand_ins",
    "precision",
    "wanted",
    "keep",
    "stages",
    "sweep",
    "design",
    "variant",
    "description",
    "requires",
    "most_cells",
    "about",
    "archive",
)


def axis_name(key: str, document: DocumentView) -> str:
    """Return the name of an axis: for a quantity its bare name, even if written ``TABLE.NAME``. A stage may have the
    same name as a table.
    """
    head, dot, name = key.partition(".")
    if not dot or head not in tables() or (head in _stages(document) and name not in _quantities(document)):
        return key
    return name


def by_one_name(overrides: DocumentView, document: DocumentView) -> Document:
    """Return the overrides under the names by which an archive records them; of two overrides with the same meaning,
    the last applies.
    """
    found: Document = {}
    for key, value in overrides.items():
        if key.startswith("sweep."):
            key = f"sweep.{axis_name(key.removeprefix('sweep.'), document)}"
        elif key.startswith("design."):
            pass
        elif "." not in key and key not in TOP and key in _quantities(document):
            key = table_in(document).place(key)
        elif "." in key and (head := key.partition(".")[0]) in tables() and head not in _stages(document):
            key = table_in(document).place(key.partition(".")[2])
        found.pop(key, None)
        found[key] = value
    return found


def flat(sweep: DocumentView) -> Document:
    """Return a sweep with one key per axis; TOML reads ``STAGE.use`` without quotes as a table, which is flattened."""
    found: Document = {}
    for key, value in sweep.items():
        if isinstance(value, dict) and value and not is_axis(value):
            found.update({f"{key}.{name}": one for name, one in value.items()})
        else:
            found[key] = value
    return found


def axes_of(document: DocumentView, faults: list[Fault]) -> Document:
    """Return the sweep of a document, each axis by its name; report an axis that is given twice."""
    found: Document = {}
    for key, values in flat(document["sweep"]).items() if isinstance(document.get("sweep"), dict) else ():
        name = axis_name(key, document)
        if name in found:
            faults.append(
                Fault(
                    f"sweep.{key}",
                    f"{name} and {table_in(document).place(name)} are the same axis, and both are given; remove one of "
                    f"them",
                )
            )
        found[name] = values
    return found


def apply_overrides(document: Document, overrides: DocumentView, file: str = "") -> list[str]:
    """Set ``TABLE.x``, ``sweep.axis``, ``<stage>.<parameter>`` or a top-level key in the document.

    Return the places that have been set.
    """
    faults: list[Fault] = []
    places = []
    axes = axes_of(document, faults)
    if isinstance(document.get("sweep"), dict) and not faults:
        document["sweep"] = axes
    faults.clear()  # reported later, with those of the rest of the file
    for key, value in by_one_name(overrides, document).items():
        head, _, tail = key.partition(".")
        named = _stages(document)
        if tail and (head in (*tables(), "sweep", "design", "about") or (head == ARCHIVE and head not in named)):
            if not isinstance(document.setdefault(head, {}), dict):
                continue  # a fault of form, reported later
            factor, word = _factor_in(document, tail) if head == "design" else (None, "")
            if factor is not None:
                factor[word] = value
                places.append(key)
                continue
            document[head][tail] = value
            places.append(key)
            _only_here(document, head, tail)
        elif tail and head in named:
            number, table = named[head]
            if tail == "use":
                table.setdefault("name", head)  # a swapped stage keeps its name
            table[tail] = value
            places.append(f"stages[{number}].{tail}")
            _only_here(document, head, key)
        elif not tail and head in (*TOP, *tables()):
            document[head] = value
            places.append(key)
        else:
            faults.append(Fault(f"--set {key}", f"cannot set {head!r}: unknown name{_meant(document, head, tail)}"))
    if faults:
        raise RequestError(faults, file)
    return places


def _factor_in(document: DocumentView, tail: str) -> tuple[Document | None, str]:
    """Return the table of a factor of the design, and the key in it that ``factors.NAME.WORD`` sets; None if there is
    no such table.
    """
    design = document["design"]
    name, dot, word = tail.removeprefix("factors.").rpartition(".")
    if not dot or not tail.startswith("factors."):
        return None, ""
    given = design.get("factors")
    known = {axis_name(key, document): one for key, one in (given if isinstance(given, dict) else {}).items()}
    known |= {
        axis_name(key.removeprefix("factors."), document): one
        for key, one in design.items()
        if key.startswith("factors.")
    }
    found = known.get(axis_name(name, document))
    return (found, word) if isinstance(found, dict) else (None, "")


def _only_here(document: Document, head: str, key: str) -> None:
    """Remove the old entry of a parameter that has become a value, an axis or a factor."""
    design = document.get("design")
    places = {"sweep": document.get("sweep"), "design": design.get("factors") if isinstance(design, dict) else None}
    for name, table in places.items():
        if isinstance(table, dict) and name != head and head != "about":
            table.pop(axis_name(key.removeprefix("factors."), document), None)


def _meant(document: DocumentView, head: str, tail: str) -> str:
    """Return a hint at the name that an unknown name may have been meant for."""
    if not tail:
        return nearest(head, [*TOP, *_quantities(document)])
    named = _stages(document)
    called = next((name for name, (_, stage) in named.items() if stage.get("use") == head), "")
    if called:
        return f"; in this file the stage {head} is named {called!r}: {called}.{tail}"
    close = nearest(head, [*named, *(name for name in tables() if name != SHARED), "sweep"])
    return close if "did you mean" in close else f"; the stages of this pipeline: {', '.join(named)}"


def _quantities(document: DocumentView) -> tuple[str, ...]:
    """Return the keys that the table of shared quantities may have: declared quantities, and quantities in the
    document.
    """
    table = table_in(document)
    given = document.get(table.name)
    return (*table.words(), *quantities.names(), *(given if isinstance(given, dict) else ()))


def _stages(document: DocumentView) -> dict[str, tuple[int, Document]]:
    """Return the stage tables by name, with their numbers."""
    stages = document.get("stages")
    entries = [(n, s) for n, s in enumerate(stages, 1) if isinstance(s, dict)] if isinstance(stages, list) else []
    return {str(s.get("name", s.get("use"))): (n, s) for n, s in entries}
