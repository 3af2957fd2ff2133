"""Terminal output of a calibration and of its check.

In:  the document of ``calibrate``.
Out: a table of parameters, and one of levels.
"""

from __future__ import annotations

import math
import sys
from pathlib import Path

from rich.console import Console

from etendue.cli.saying import tell
from etendue.errors import RequestError
from etendue.present.plots.plot import check_suffix
from etendue.present.terminal.terminal import _out, _print_whole, _table, escape
from etendue.result_files import check_folder, write_whole
from etendue.types.documents import Document
from etendue_lab.calibrate.drawing import photon_transfer
from etendue_lab.calibrate.study import Geometry, calibrated

PERCENT = ("dark_nonuniformity", "light_excess", "prnu", "prnu_total", "quantum_efficiency", "bend")


def print_calibration(document: Document) -> None:
    """Print parameters with intervals, the frames that missing parameters need, and the check."""
    console = _out()
    console.print(
        f"{escape(document['measurement'])}: {document['frames']} frames of {document['columns']} x {document['rows']} "
        f"pixels; {100 * document['confidence']:.0f} % intervals"
    )
    for one in document["channels"]:
        columns = (
            ("parameter", "left", _named),
            ("value", "right", lambda row: _text(row, "value")),
            ("interval", "left", lambda row: f"{_text(row, 'low')} to {_text(row, 'high')}"),
            ("how", "left", "how"),
        )
        console.print(_table(f"channel {one['channel']}", *columns, rows=one["parameters"], wrap=("how",)))
        for name, need in one["needs"].items():
            console.print(f"{name.replace('_', ' ')}: needs {escape(need)}")
        for test in one["tests"]:
            console.print(f"test: {escape(test)}")
    if (edge := document["edge"]) is not None:
        sigma = f"{edge['sigma']:.4g} um ({edge['sigma_low']:.4g} to {edge['sigma_high']:.4g})"
        console.print(
            f"lens from {escape(edge['file'])}: Gaussian blur of sigma {sigma}, pixel divided out; MTF50 of both "
            f"{edge['mtf50']:.4g} cycles/pixel; up to Nyquist its response differs from the response of such a "
            "blur by at most "
            f"{edge['misfit']:.2g}"
        )
    for check in document["checks"]:
        _print_check(console, check)
    for note in document["notes"]:
        console.print(f"note: {escape(note)}")


def _print_check(console: Console, check: Document) -> None:
    columns = (
        ("light", "right", "light", _short),
        ("judged", "left", lambda row: "yes" if row["judged"] else "no"),
        ("frames", "right", "frames"),
        ("signal", "right", "signal", _short),
        ("predicted", "right", "signal_predicted", _short),
        ("variance", "right", "variance", _short),
        ("predicted", "right", "variance_predicted", _short),
        ("spatial variance", "right", "spatial", _short),
        ("spatial, simulated", "right", "spatial_predicted", _short),
        ("histogram distance", "right", "histogram_distance", _short),
        ("by chance", "right", "histogram_expected", _short),
    )
    title = f"check of channel {check['channel']}: DN and DN^2, unscaled"
    _print_whole(console, title, columns, check["levels"], keys=3)
    for name, words in (
        ("variance_rms", "variance, rms"),
        ("variance_worst", "variance, worst level"),
        ("mean_worst", "mean, worst level"),
    ):
        verdict = "within" if check["within"][name] else "beyond"
        chance = {
            "variance_rms": ("sampling", check["variance_sampling"]),
            "variance_worst": ("sampling", check["variance_worst_sampling"]),
            "mean_worst": ("the light's scatter", 1.96 * check["light_scatter"]),
        }
        who, size = chance[name]
        own = f", of which {who} gives {100 * size:.3g} %"
        console.print(
            f"{words}: {100 * check[name]:.3g} % of {check['judged']} levels of 2 to 90 % of saturation{own}: "
            f"{verdict} {100 * check['limits'][name]:.3g} %"
        )


def _named(row: Document) -> str:
    unit = "%" if row["name"] in PERCENT else row["unit"]
    return f"{row['name'].replace('_', ' ')}{', ' * bool(unit)}{unit}"


def _text(row: Document, name: str) -> str:
    value, scale = row[name], 100.0 if row["name"] in PERCENT else 1.0
    return "" if value is None or math.isnan(value) else f"{scale * value:.5g}"


def _short(value: float | None) -> str:
    return "" if value is None or math.isnan(value) else f"{value:.4g}"


def calibrate_command(
    frames: Path,
    output: Path | None,
    check: bool,
    figure: Path | None,
    pitch: float | None,
    aperture: float | None,
    edge: Path | None,
    edge_window: str | None,
    window: str | None,
    pattern: str | None,
    as_json: bool,
) -> None:
    if edge is not None and (pitch is None or aperture is None):
        raise RequestError(
            "--edge: the blur of the pixel is divided out and must be known: give --pitch UM and --aperture SHARE (1 "
            "with microlenses)"
        )
    if edge_window is not None and edge is None:
        raise RequestError("--edge-window: the rectangle of an edge; give --edge FILE")
    if output is not None:
        if output.suffix != ".toml" or output.is_dir():
            raise RequestError(f"--output {output}: a sensor file is a file that ends in .toml, such as mine.toml")
        check_folder(output.parent)
    if figure is not None:
        check = True
        check_suffix(figure)
    geometry = Geometry(pitch, aperture, edge, edge_window)
    document, text = calibrated(frames, window, pattern, geometry, check)
    if output is not None:
        write_whole(output.parent, {output.name: text.encode()})
        if pitch is None:
            document["notes"].append("its pixel pitch is assumed: give --pitch UM; charges do not depend on it")
        document["notes"].append(f'[camera] sensor = "./{output.name}" uses {output}')
    if figure is not None:
        photon_transfer(document["checks"], document["measurement"]).save(figure)
    tell(as_json, document, print_calibration)
    sys.exit(3 if any(not all(one["within"].values()) for one in document["checks"]) else 0)
