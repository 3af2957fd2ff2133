"""Stand-ins: typical values that presets use if no source gives a value. Every display of a result names them.

In:  a pipeline, and the shared quantities that its stages use.
Out: for each preset, the quantities with a typical value that the pipeline does not override.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping

from etendue.pipeline.file import PipelineFile
from etendue.pipeline.presets import preset_at


def standing_in(pipeline: PipelineFile, used: Collection[str]) -> dict[str, tuple[str, ...]]:
    """Return the stand-ins of every preset that comes from a file or is found by its name, by kind and title of the
    preset.

    Packaged presets are not included: the command that lists them prints their sources.
    """
    found: dict[str, tuple[str, ...]] = {}
    for kind in pipeline.table.kinds():
        axis = pipeline.sweep.get(kind.preset)
        entries = axis if isinstance(axis, list | tuple) else [pipeline.named.get(kind.preset, "")]
        for entry in entries:
            own = entry if isinstance(entry, Mapping) else {kind.preset: entry}
            if not own.get(kind.preset):
                continue
            one = preset_at(str(own[kind.preset]), kind, pipeline.folder)
            given = {**pipeline.shared, **own, **dict.fromkeys(pipeline.sweep)}
            names = tuple(
                name
                for name, value in one.shared.items()
                if value.stands_in and name in used and given.get(name, value.value) == value.value
            )
            if names and one.file:
                found[f"{kind.preset} {one.title}"] = names
    return found
