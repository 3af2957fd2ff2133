"""Tables of real camera bodies and lenses.

In:  a name, words to search for, or a file of another program.
Out: values with their sources on the terminal or as JSON; a file for a pipeline.
"""

from __future__ import annotations

from decimal import Decimal
from pathlib import Path
from typing import Any

from etendue.cli.saying import tell
from etendue.errors import RequestError
from etendue.present.terminal.terminal import _out, _table, escape
from etendue.result_files import write_whole
from etendue.types.documents import Document
from etendue_camera.cameras import bodies, dng, files, lenses
from etendue_camera.cameras.databases import INSTALL, lens_folder, lens_index
from etendue_camera.cameras.documents import Named, Value
from etendue_camera.cameras.names import matching, plain


def cameras_command(name: str | None, lenses: bool, search: str | None, output: Path | None, as_json: bool) -> None:
    """Run the command."""
    if name:
        whole = files.named_in(Path(name)) if files.is_path(name) else _named(name, lenses)
        if output is not None:
            write_whole(output.parent, {output.name: _text(whole, name, output).encode()})
        tell(as_json, document_of(whole), print_one)
        return
    found = listing(search or "", bodies=not lenses or bool(search), lens_names=lenses or bool(search))
    tell(as_json, found, print_listing)


def _text(whole: Named, name: str, output: Path) -> str:
    """Return the text to write: the body or lens as TOML, or a table of the file as CSV."""
    if output.suffix != ".csv":
        return whole.toml()
    tables: dict[str, str] = {}
    if files.is_path(name):
        if (own := files.table_in(Path(name))) is not None:
            return own
        if name.casefold().endswith(".dng"):
            pitch = float(str(whole.camera["pixel_pitch"].value).split()[0])
            tables = files.lens_tables(dng.raw(Path(name).read_bytes(), name), pitch)
    which = output.stem.rpartition(".")[2]
    if which not in tables:
        names = ", ".join(f"NAME.{one}.csv" for one in tables)
        raise RequestError(f"{name} holds no table for {output.name}; {f'write {names}, or ' * bool(names)}NAME.toml")
    return tables[which]


def _named(name: str, only_lenses: bool) -> Named:
    """Return the body or lens with the name that the user typed."""
    faults: list[str] = []
    if not only_lenses:
        try:
            return bodies.found_body(name)
        except RequestError as error:
            faults.append(str(error))
    try:
        return lenses.lens(lenses.full_lens_name(name))[0]
    except RequestError as error:
        raise RequestError(faults[0] if faults and lens_index() is None else "; ".join([*faults, str(error)])) from None


def document_of(one: Named) -> Document:
    return {
        "name": one.title,
        "kind": one.kind,
        "description": one.description,
        "camera": {key: _value(value) for key, value in one.camera.items()},
        "facts": {key: _value(value) for key, value in one.facts.items()},
    }


def _value(one: Value) -> Document:
    return {
        "value": _plain(one.value),
        "source": one.source,
        "licence": one.licence,
        "note": one.note,
        "stand_in": one.source.startswith(bodies.TYPICAL),
    }


def _plain(value: Any) -> Any:
    if isinstance(value, list):
        return [_plain(one) for one in value]
    return float(value) if isinstance(value, Decimal) else value


def listing(text: str, bodies: bool, lens_names: bool) -> Document:
    found: Document = {"bodies": [], "lenses": [], "refused": [], "note": ""}
    if bodies:
        found["bodies"] = _bodies(text)
    folder = lens_folder()
    if lens_names:
        found["lenses"] = [{"name": name} for name in matching(text, lenses.module_lenses())]
    if folder is None:
        found["note"] = f"the lensfun database, with more bodies and lenses, was not found: {INSTALL}"
    elif lens_names:
        index = lenses.index()
        found["lenses"] += [{"name": name} for name in matching(text, sorted(index.lenses))]
        found["refused"] = [{"name": name, "why": why} for name, why in index.refused if matching(text, [name])]
    if text and not found["bodies"] and not found["lenses"] and not found["refused"]:
        raise RequestError(
            f"no camera or lens has all of the words {text!r}{'; ' * bool(found['note'])}{found['note']}"
        )
    return found


def _bodies(text: str) -> list[Document]:
    packaged, listed = bodies.packaged(), bodies.cameras()
    known = {plain(name) for name in packaged}
    rows = []
    for name in matching(text, [*packaged, *(name for name in listed if plain(name) not in known)]):
        row = packaged.get(name, {})
        rows.append(
            {
                "name": name,
                "format": row.get("format") or "",
                "crop_factor": listed[name].crop_factor if name in listed else None,
                "mount": listed[name].mount if name in listed else "",
                "sensitivity": "measured" if row.get("sensitivity") else "stand-in",
                "values": row.get("sensor") or row.get("tuning") or "",
            }
        )
    return rows


def print_listing(document: Document) -> None:
    console = _out()
    if document["bodies"]:
        columns = (
            ("body", "left", "name"),
            ("format", "left", "format"),
            ("crop", "right", "crop_factor", lambda value: "" if value is None else f"{value:g}"),
            ("mount", "left", "mount"),
            ("sensitivity", "left", "sensitivity"),
            ("values from", "left", "values"),
        )
        console.print(_table("bodies", *columns, rows=document["bodies"], wrap=("body",)))
    if document["lenses"]:
        console.print(_table("lenses", ("lens", "left", "name"), rows=document["lenses"], wrap=("lens",)))
    if document["refused"]:
        why = (("refused", "left", "name"), ("why", "left", "why"))
        console.print(_table("entries that cannot be used", *why, rows=document["refused"], wrap=("refused", "why")))
    if document["note"]:
        console.print(f"note: {escape(document['note'])}", soft_wrap=True)
    console.print('in a pipeline: \\[camera] body = "NAME", lens = "NAME"\nvalues and sources: etendue cameras NAME')


def print_one(document: Document) -> None:
    """Print every value with its source; stand-ins are marked with *."""
    console = _out()
    console.print(f"{escape(document['name'])}\n{escape(document['description'])}\n")
    sources = list(
        dict.fromkeys(
            (one["source"], one["licence"])
            for part in ("camera", "facts")
            for one in document[part].values()
            if not one["stand_in"]
        )
    )
    for part, title in (("camera", "values under [camera]"), ("facts", "also known")):
        if document[part]:
            rows = [{"key": key, **one} for key, one in document[part].items()]
            table = _table(
                escape(title),
                ("quantity", "left", "key"),
                ("value", "left", "value", _shown),
                ("source", "left", lambda one: _source(one, sources)),
                ("note", "left", "note"),
                rows=rows,
                wrap=("note", "value"),
            )
            console.print(table)
    for number, (source, licence) in enumerate(sources, 1):
        console.print(f"({number}) {escape(source)}{f', {escape(licence)}' if licence else ''}", soft_wrap=True)
    stand_ins = [key for key, one in document["camera"].items() if one["stand_in"]]
    if stand_ins:
        console.print(f"stand-ins, marked *: {escape(', '.join(stand_ins))}", soft_wrap=True)


def _shown(value: Any) -> str:
    text = ", ".join(map(str, value)) if isinstance(value, list) else str(value)
    return Path(text).name if text.endswith(".lens") else text


def _source(one: Document, sources: list[tuple[str, str]]) -> str:
    return "* stand-in" if one["stand_in"] else f"({sources.index((one['source'], one['licence'])) + 1})"
