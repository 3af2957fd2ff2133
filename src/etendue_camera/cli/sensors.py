"""The sensors that a pipeline may name, in tables.

In:  a preset.
Out: its values with their sources, on the terminal or as JSON.
"""

from __future__ import annotations

from decimal import Decimal
from typing import Any

from etendue.errors import RequestError
from etendue.pipeline.presets import Sourced, preset, preset_names
from etendue.plugins.discovery import OWN
from etendue.present.terminal.terminal import _out, _table, escape
from etendue.types.documents import Document


def sensor_document(name: str) -> Document:
    """One sensor as JSON holds it."""
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
    """Every sensor in a line."""
    columns = (("sensor", "left"), ("pitch", "right"), ("full well", "right"), ("what it is", "left"))
    table = _table("sensors", *columns, wrap=("what it is",))
    for d in documents:
        if "broken" in d:
            continue
        well = d["facts"].get("full_well", {}).get("value", "")
        pitch = d["camera"].get("pixel_pitch", {}).get("value", "")
        origin = "" if d["distribution"] == OWN else f" (from {d['distribution']} {d['version']})"
        table.add_row(d["name"], str(pitch), str(well), escape(d["title"] + origin))
    console = _out()
    console.print(table)
    for d in documents:
        if "broken" in d:
            console.print(f"broken: {d['name']}: {escape(d['broken'])}")
    console.print('in a pipeline: \\[camera] sensor = "NAME"\nvalues and sources: etendue sensors NAME')


def print_sensor(document: Document) -> None:
    """Every value of a sensor with its source; addresses stand below, whole."""
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
                ("quantity", "left"),
                ("value", "left"),
                ("source", "left"),
                ("note", "left"),
                wrap=("note",),
            )
            for key, one in document[name].items():
                value = ", ".join(map(str, one["value"])) if isinstance(one["value"], list) else str(one["value"])
                source = f"({addresses.index(one['source']) + 1})" if one["source"] in addresses else one["source"]
                table.add_row(key, escape(value), escape(source), escape(one["note"]))
            console.print(table)
    for number, address in enumerate(addresses, 1):
        console.print(f"({number}) {escape(address)}", soft_wrap=True)
