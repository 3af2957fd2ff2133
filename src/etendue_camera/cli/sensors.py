"""Tables of the sensors that a pipeline can use.

In:  a preset.
Out: its values with their sources, on the terminal or as JSON.
"""

from __future__ import annotations

from decimal import Decimal
from typing import Any

from etendue.cli.bodies.catalogue import tell_one
from etendue.errors import RequestError
from etendue.pipeline.presets import Sourced, preset, preset_names
from etendue.present.terminal.catalogue import _origin
from etendue.present.terminal.terminal import _out, _table, escape
from etendue.types.documents import Document


def sensor_document(name: str) -> Document:
    """Return the JSON document of one sensor."""
    try:
        found = preset(name)
    except RequestError as error:
        if name not in preset_names():
            raise
        return {"name": name, "broken": str(error)}
    return {
        "name": name,
        "distribution": found.distribution,
        "version": found.version,
        "title": found.title,
        "kind": found.kind,
        "description": found.description,
        "camera": {key: _sourced(value) for key, value in found.shared.items()},
        "facts": {key: _sourced(value) for key, value in found.facts.items()},
    }


def _sourced(one: Sourced) -> Document:
    return {"value": _plain(one.value), "source": one.source, "note": one.note}


def _plain(value: Any) -> Any:
    if isinstance(value, list):
        return [_plain(v) for v in value]
    return float(value) if isinstance(value, Decimal) else value


def print_sensors(documents: list[Document]) -> None:
    """Print one line per sensor."""
    columns = (
        ("sensor", "left", "name"),
        ("pitch", "right", lambda d: d["camera"].get("pixel_pitch", {}).get("value", ""), str),
        ("full well", "right", lambda d: d["facts"].get("full_well", {}).get("value", ""), str),
        ("description", "left", lambda d: d["title"] + _origin(d)),
    )
    console = _out()
    console.print(_table("sensors", *columns, rows=[d for d in documents if "broken" not in d], wrap=("description",)))
    for d in documents:
        if "broken" in d:
            console.print(f"broken: {d['name']}: {escape(d['broken'])}")
    console.print('in a pipeline: \\[camera] sensor = "NAME"\nvalues and sources: etendue sensors NAME')


def print_sensor(document: Document) -> None:
    """Print every value of a sensor with its source; addresses are listed below in full."""
    console = _out()
    if "broken" in document:
        console.print(f"broken: {escape(document['broken'])}")
        return
    console.print(f"{escape(document['title'])}\n{escape(document['description'])}\n")
    addresses = list(
        dict.fromkeys(
            one["source"] for name in ("camera", "facts") for one in document[name].values() if ":" in one["source"]
        )
    )
    for name, title in (("camera", "values under [camera]"), ("facts", "also published")):
        if document[name]:
            table = _table(
                escape(title),
                ("quantity", "left", "key"),
                ("value", "left", "value", lambda own: ", ".join(map(str, own if isinstance(own, list) else [own]))),
                ("source", "left", "source", lambda own: f"({addresses.index(own) + 1})" if own in addresses else own),
                ("note", "left", "note"),
                rows=[{"key": key, **one} for key, one in document[name].items()],
                wrap=("note",),
            )
            console.print(table)
    for number, address in enumerate(addresses, 1):
        console.print(f"({number}) {escape(address)}", soft_wrap=True)


def sensors_command(name: str | None, as_json: bool) -> None:
    tell_one(as_json, name, preset_names(), sensor_document, print_sensor, print_sensors)
