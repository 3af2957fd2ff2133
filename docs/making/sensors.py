"""Make a page of the packaged sensors: each value with its source, as a link if it is one."""

from collections.abc import Mapping
from typing import Any

from etendue.contract.values.units import as_written
from etendue.pipeline.presets import preset, preset_names
from making.markdown import shown, table


def page() -> str:
    """Return the page, with a section for each sensor."""
    parts = [
        "# Packaged sensors",
        "Every value with its source, as printed by `etendue sensors NAME`; `typical` marks values that were not "
        "measured on that sensor. How to use "
        "them: [sensors.md](../sensors.md).",
    ]
    for name in preset_names():
        one = preset(name)
        parts += [
            f"## {name}",
            shown(f"{one.title}. {one.description}"),
            table(("quantity", "value", "source"), _rows({**one.facts, **one.shared})),
        ]
    return "\n\n".join(parts)


def _rows(values: Mapping[str, Any]) -> list[tuple[str, str, str]]:
    return [(f"`{name}`", f"`{as_written(one.value)}`", _source(one)) for name, one in values.items()]


def _source(one: Any) -> str:
    place = (
        f"[{one.source.partition('//')[2].partition('/')[0]}](<{one.source}>)"
        if one.source.startswith("http")
        else shown(one.source)
    )
    return f"{place}; {shown(one.note)}" if one.note else place
