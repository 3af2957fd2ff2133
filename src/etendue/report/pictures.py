"""Pictures: every stage of one cell as it looks to the eye.

In:  the thumbnails of the shown cells.
Out: 8-bit sRGB frames fitted into 256 x 256, as a table of the archive, and the contact sheet that shows them in order.

A linear picture is scaled so that its 99.5th percentile is 0.9, the same for all stages of one kind, so that what gets darker looks
darker.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from etendue.physics.colour.encoding import srgb_encode
from etendue.plan.model import CellRef, Plan
from etendue.report.contact_sheet import contact_sheet
from etendue.report.thumbnails import Thumbnail
from etendue.spec.ports import Sheet
from etendue.spec.variables import variable as known


@dataclass
class Frame:
    """One picture: what it is of, (3, y, x) in 0..1 as encoded sRGB, and the true size."""

    stage: str
    variable: str
    picture: Any
    size: tuple[int, int]


def render(plan: Plan, shown: Mapping[str, CellRef], small: Mapping[CellRef, Mapping[str, Thumbnail]]) -> list[Frame]:
    """A frame for every stage with a picture; linear pictures of one kind share one scale."""
    order: list[tuple[str, str, Thumbnail]] = []
    last: dict[str, Thumbnail] = {}
    for node in plan.nodes:
        own = small.get(shown[node.name], {})
        for variable in node.writes:
            if variable in own:
                order.append((node.name, variable, own[variable]))
                last[known(variable).scale or variable] = own[variable]
    frames = []
    scales: dict[str, float] = {}
    for stage, variable, one in order:
        how, picture = known(variable), one.picture
        kind = how.scale or variable
        if how.shown == "linear":
            if kind not in scales:
                bright = how.white
                if bright is None:
                    # where several variables share a scale the last picture says what is bright: what a well cannot hold is no brightness
                    peaks = (last[kind].picture if how.scale else picture).max(axis=0)
                    # a thousandth of the brightest at least: beside a point all else may be next to nothing
                    bright = max(float(np.quantile(peaks, 0.995)), 1e-3 * float(peaks.max())) / 0.9
                scales[kind] = bright if bright > 0 else 1.0
            picture = srgb_encode(np.clip(picture / scales[kind], 0, 1))
        frames.append(Frame(stage, variable, np.clip(picture, 0, 1), one.size))
    return frames


def sheet(plan: Plan, shown: Mapping[str, CellRef], small: Mapping[CellRef, Mapping[str, Thumbnail]], at: str) -> Sheet | None:
    """The pictures of the shown cells, which stand at the axis values ``at``; None where there is nothing to be seen."""
    frames = render(plan, shown, small)
    if not frames:
        return None
    table, title = frames_table(frames), f"{plan.pipeline.name}{at}"
    return Sheet(table, lambda path: contact_sheet(table, path, title), tuple(shown.values()), at)


def frames_table(frames: list[Frame]) -> dict[str, Any]:
    """The frames as a group of the archive: preview(stage, channel, y, x), 8 bit, zero beside smaller ones."""
    height, width = max(f.picture.shape[1] for f in frames), max(f.picture.shape[2] for f in frames)
    preview = np.zeros((len(frames), 3, height, width), np.uint8)
    for i, frame in enumerate(frames):
        _, y, x = frame.picture.shape
        preview[i, :, :y, :x] = np.round(frame.picture * 255)
    names = [f.stage for f in frames]
    stage = [n if names.count(n) == 1 else f"{n}.{f.variable}" for n, f in zip(names, frames, strict=True)]
    dims = ("stage", "channel", "y", "x")
    return {
        "arrays": {
            "preview": (
                dims,
                preview,
                {"long_name": "the stage as it looks", "colour_space": "sRGB", "transfer_function": "sRGB", "units": "1"},
            ),
            "stage": (("stage",), np.array(stage, dtype=object), {"long_name": "stage"}),
            "channel": (("channel",), np.array(["R", "G", "B"], dtype=object), {"long_name": "channel"}),
            "variable": (("stage",), np.array([f.variable for f in frames], dtype=object), {"long_name": "variable"}),
            "true_height": (("stage",), np.array([f.size[0] for f in frames]), {"units": "pixel", "long_name": "true height"}),
            "true_width": (("stage",), np.array([f.size[1] for f in frames]), {"units": "pixel", "long_name": "true width"}),
            "height": (
                ("stage",),
                np.array([f.picture.shape[1] for f in frames]),
                {"units": "pixel", "long_name": "height of the preview"},
            ),
            "width": (("stage",), np.array([f.picture.shape[2] for f in frames]), {"units": "pixel", "long_name": "width of the preview"}),
        },
        "attrs": {"title": "one cell of every stage, in order"},
    }
