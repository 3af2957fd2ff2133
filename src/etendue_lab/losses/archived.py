"""What each stage of an archived camera is owed of the lost contrast, SNR and colour, at one place of its sweep.

In:  the folder of an archive, values of its axes.
Out: the document of ``studies.losses`` for the camera that stands there, from the pipeline that the archive holds.
"""

from __future__ import annotations

import copy
import tomllib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from etendue.archive.again import recorded
from etendue.contract.registry import installed_stages
from etendue.contract.stage import parameters_of
from etendue.errors import EtendueError
from etendue.pipeline import toml
from etendue.pipeline.file import Pipeline, parse_pipeline
from etendue.result_files import finite
from etendue_lab.losses.study import RUNS, losses

SENSOR = "sensor"  # the word for presets of a camera
ABOUT = (
    "The camera{at}: what a stage adds to a loss, averaged over all orders in which the stages of the ideal camera "
    "could be"
    " made real (Shapley values); the shares are of what is lost before others win it back, and a stage below 0 wins "
    "back. "
    "Contrast and signal-to-noise ratio are of a grey card, colour of the scene."
)


def losses_at(
    folder: Path, at: Mapping[str, Any], told: Callable[[str], None] = lambda text: None, runs: int = RUNS
) -> dict[str, Any]:
    """Shapley values of the camera at some values of its axes, ``{dim: value}``; ``why`` in their place where there are
    none.

    Only cameras of a grey card and, for colour, at most ``runs`` of the scene are computed; nothing of the archive is.
    """
    try:
        found: dict[str, Any] = finite(
            losses(camera_at(folder, at), installed_stages(), runs=runs, told=told).document()
        )
    except EtendueError as error:
        return {"losses": [], "notes": [], "why": str(error).strip().split("\n")[-1]}
    shown = [{**loss, "value": loss["camera"]} for loss in found["losses"]]  # the word that whoever shows it knows
    return {**found, "losses": shown, "about": ABOUT, "why": ""}


def camera_at(folder: Path, at: Mapping[str, Any]) -> Pipeline:
    """The pipeline of an archive's last run without its sweep: every axis at one of its values.

    Raises
    ------
    ArchiveError
        Its record or an input is damaged or missing.
    RequestError
        The recorded pipeline cannot be read here.
    """
    run = recorded(folder)
    document, axes = tomllib.loads(run.text), run.record["axes"]
    swept = _flat(document.pop("sweep", {}))
    for key in sorted(swept, key=lambda key: not _chooses(key)):
        written = swept[key]
        dim = key.removesuffix(".use").replace(".", "_")
        values = list(axes.get(key, ()))
        value = at.get(dim, values[0] if values else None)
        item = (
            written[values.index(value)]
            if isinstance(written, list) and value in values and len(written) == len(values)
            else value
        )
        _set(document, key, item)
    again = parse_pipeline(toml.dumps(document), str(run.path.with_suffix(".toml")), run.path.parent)
    run.pipeline()  # its inputs are held against their digests
    return again


def _flat(table: Mapping[str, Any], front: str = "") -> dict[str, Any]:
    """``{"sharpen": {"strength": [..]}}`` as ``{"sharpen.strength": [..]}``; what has ``from`` is a span of values."""
    found: dict[str, Any] = {}
    for name, own in table.items():
        if isinstance(own, Mapping) and "from" not in own:
            found |= _flat(own, f"{front}{name}.")
        else:
            found[f"{front}{name}"] = own
    return found


def _chooses(key: str) -> bool:
    """Whether an axis chooses a stage or a sensor: what the others set is of that one."""
    return key == SENSOR or key.endswith(".use")


def _set(document: dict[str, Any], key: str, item: Any) -> None:
    """One value of an axis in the place where a pipeline file says it."""
    stage, _, name = key.rpartition(".")
    if not stage:
        camera = document.setdefault("camera", {})
        camera.update(
            {k: v for k, v in item.items() if k != "label"}
            if key == SENSOR and isinstance(item, Mapping)
            else {key: item}
        )
        return
    for table in document["stages"]:
        if table.get("name", table["use"]) == stage:
            if name == "use":
                place = {"name": stage, **({"from": table["from"]} if "from" in table else {})}
                own = dict(item) if isinstance(item, Mapping) else {"use": item}
                own = {**_parameters(table, own["use"]), **own}
                own.pop("label", None)
                table.clear()
                table.update(copy.deepcopy({**own, **place}))
            elif _takes(str(table["use"]), name):
                table[name] = item


def _takes(use: str, parameter: str) -> bool:
    """Whether a stage has a parameter: of those that an axis chooses among some may not."""
    stages = installed_stages()
    return use not in stages or parameter in parameters_of(stages.load(use))


def _parameters(table: Mapping[str, Any], use: Any) -> dict[str, Any]:
    """What the file says of a stage goes with its own implementation, and not with others."""
    return {k: v for k, v in table.items() if k not in ("use", "name", "from")} if table["use"] == use else {}
