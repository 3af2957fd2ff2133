"""Real frames beside those of cameras fitted to them: the figures, the pictures and the tables of docs/reality.md.

python benchmarks/reality.py --data DIR    # measures emva_001.npz and emva_003.npz of DIR
python benchmarks/reality.py               # draws page and pictures from reality.json alone
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

from etendue.result_files import finite
from etendue_lab.calibrate.drawing import photon_transfer
from etendue_lab.calibrate.study import calibrated
from etendue_lab.emva.frames import measured
from etendue_lab.emva.names import NAMES, PERCENT

ROOT = Path(__file__).parents[1]
NAMED = ROOT / "benchmarks" / "real_cameras.json"
WRITTEN, PAGE, PICTURES = ROOT / "benchmarks" / "reality.json", ROOT / "docs" / "reality.md", ROOT / "docs" / "pictures"
BASLER = "frames: EMVA 1288 datasets, Basler AG, CC BY-SA 3.0; this picture: CC BY-SA 3.0"
SETS: dict[str, dict[str, Any]] = {
    "emva_001": {
        "title": "A CCD, 12 bits, exposure times varied at constant light",
        "notice": BASLER,
        "reference": {
            "gain": 0.28042,
            "quantum_efficiency": 0.4512,
            "read_noise": 10.91,
            "saturation_capacity": 14373,
            "dsnu": 0.137,
            "prnu": 0.003061,
        },
    },
    "emva_003": {
        "title": "A sensor simulated in Heidelberg, 12 bits, light varied at one exposure time",
        "notice": "frames: EMVA 1288 datasets, University of Heidelberg (HCI), 2011",
        "reference": {
            "gain": 0.09791,
            "quantum_efficiency": 0.5073,
            "read_noise": 30.57,
            "dsnu": 21.81,
            "prnu": 0.005926,
        },
        "truth": {"gain": 0.1, "bend": 0.02, "read_noise": 30, "dsnu": 15, "dsnu_total": 21.21, "prnu": 0.005},
    },
}
LEVEL = (
    "light", "frames", "signal", "signal_predicted", "variance", "variance_low", "variance_high", "variance_predicted",
    "spatial", "spatial_error", "spatial_predicted", "histogram_distance", "histogram_expected", "row_spectrum",
    "row_spectrum_predicted", "column_spectrum", "column_spectrum_predicted", "judged", "label_fits",
)  # fmt: skip


def measure(data: Path) -> dict[str, Any]:
    """Measure every set that is there."""
    found = {}
    for name in SETS:
        path = data / f"{name}.npz"
        document, _ = calibrated(path, check=True)
        for check in document["checks"]:
            check["levels"] = [{key: _short(row[key]) for key in LEVEL} for row in check["levels"]]
        found[name] = {"emva": measured(path, None, None)["channels"][0]["figures"], "calibration": document}
    return found


def _short(value: Any) -> Any:
    return float(f"{value:.6g}") if isinstance(value, float) else value


def page(found: dict[str, Any]) -> str:
    """Return the page: of calibrated frames, and of cameras and lenses by name."""
    named = json.loads(NAMED.read_text())
    parts = [
        "# Predicted beside measured\n",
        "This page compares real frames with the frames of a simulated camera that was fitted to them. Nothing is",
        "rescaled: predictions have the unit of the measurement, and the tables state the differences.",
        "`python benchmarks/reality.py --data DIR` measures the frames (the central 256 x 256 pixels of two sets of",
        "the public repository EMVA1288/datasets); without `--data` it draws this page from `benchmarks/reality.json`.",
        "[desk](desk.md) describes how to make a sensor file from your own frames. The rows on real cameras and lenses",
        "come from `python benchmarks/real_cameras.py --camconst FILE --lensfun FOLDER --points 500`;",
        "[cameras](cameras.md) describes these files.\n",
        *_summary(found, named),
    ]
    for name, about in SETS.items():
        if name in found:
            parts += _set(name, about, found[name])
    return "\n".join([*parts, *_named(named)])


def _summary(found: dict[str, Any], named: dict[str, Any]) -> list[str]:
    """Return one row per thing that was predicted and measured."""
    rows = []
    for name, own in found.items():
        check = own["calibration"]["checks"][0]
        lines = _median_lines([row for row in check["levels"] if row["judged"]])
        title = SETS[name]["title"].partition(",")[0]
        rows += [
            (
                "photon transfer",
                f"{title}: variance over {check['judged']} levels",
                f"{100 * check['variance_rms']:.2f} % rms",
            ),
            (
                "patterns",
                f"{title}: spatial variance, level with the most frames",
                f"{100 * check['spatial_at_stack']:+.1f} %",
            ),
            (
                "patterns",
                f"{title}: power of row means, relative to white noise",
                f"{lines[1]:.2f} predicted, {lines[0]:.2f} measured",
            ),
        ]
    for name, own in named["full_scale"].items():
        if own["measured"]:
            off = 100 * (own["tuning"] / own["measured"] - 1)
            text = f"{own['tuning']:.0f} of {own['measured']:.0f} electrons ({off:+.1f} %)"
            rows.append(
                (
                    "full scale",
                    f"{name}, from its Raspberry Pi tuning file, compared with a published measurement",
                    text,
                )
            )
    whites, falls, tables = named["whites"], named["falls"], named["lensfun"]
    long, wide = falls["normal_and_long"], falls["wide"]
    whose = f"compared with that of makers' DNG matrices, {len(whites['bodies'])} bodies"
    rows += [
        ("whites", f"white balance under D65 from measured sensitivities, {whose}",
         f"{whites['rms']:.3f} stop rms, {whites['largest']:.2f} at most"),
        ("fall-off", f"corner at f/11, cos4 law compared with {long['lenses']} long lenses",
         f"{long['rms']:.2f} stop rms"),
        ("fall-off", f"the same for {wide['lenses']} wide lenses, mostly retrofocus", f"{wide['rms']:.2f} stop rms"),
        ("distortion",
         f"heights for {tables['points']} random lenses and settings, compared with lensfun {tables['lensfun']}",
         f"{max(tables['distortion']['largest'], tables['colours']['largest']):.1e} of the field at most"),
        ("fall-off", "their fall-off, compared with lensfun", f"{100 * tables['fall_off']['largest']:.2g} % at most"),
    ]  # fmt: skip
    return ["| kind | what | difference |", "|---|---|---|", *(f"| {' | '.join(row)} |" for row in rows), ""]


def _named(named: dict[str, Any]) -> list[str]:
    """Return the section on cameras and lenses that exist."""
    parts = [
        "## Cameras and lenses by name\n",
        "Whites: red and blue over green under D65, in stops: values from the measured sensitivity minus values",
        "from the maker's matrix. The sensitivity curves were not fitted to anything.\n",
        "| body | red | blue |", "|---|---|---|",
        *(f"| {name} | {red:+.3f} | {blue:+.3f} |" for name, (red, blue) in named["whites"]["bodies"].items()),
        f"\nTogether {named['whites']['rms']:.3f} stop rms.\n",
        "Full scale, electrons: (65535 - black) / slope^2, with black level and noise slope of the tuning file.\n",
        "| sensor | from the tuning file | published measurement | |", "|---|---|---|---|",
    ]  # fmt: skip
    for name, own in named["full_scale"].items():
        measured = "" if own["measured"] is None else f"{own['measured']:.0f}"
        note = own["source"] or (
            "not used: many files contain this slope, which seems to be a default" if own["default"] else ""
        )
        parts.append(f"| {name} | {own['tuning']:.0f} | {measured} | {note} |")
    parts += [
        "\nFall-off at the corner of the calibrated sensor at f/11, in stops. Without a calibration the cos4 law is",
        "used, which is right for long lenses and too dark for wide-angle lenses, whose exit pupils lie far",
        "from the sensor.\n",
        "| lens | mm | measured | cos4 |", "|---|---|---|---|",
    ]  # fmt: skip
    for name, (focal, measured, law) in sorted(named["falls"]["examples"].items(), key=lambda one: one[1][0]):
        parts.append(f"| {name} | {focal:g} | {measured:.2f} | {law:.2f} |")
    return [
        *parts,
        "\nThe calibrations are from the lensfun database, CC BY-SA 3.0; this table has the same licence.\n",
    ]


def _set(name: str, about: dict[str, Any], own: dict[str, Any]) -> list[str]:
    parts = [
        f"## {about['title']}\n",
        f"Set `{name}`; {about['notice']}.\n",
        f"![Photon transfer](pictures/{name}.png)\n",
    ]
    parts += ["EMVA 1288 (linear), compared with the reference program `emva1288` 1.0.2 on the same crops:\n",
              "| metric | etendue | 95 % interval | reference program |", "|---|---|---|---|"]  # fmt: skip
    for row in own["emva"]:
        if row["value"] is None:
            continue
        scale, unit = (100.0, "%") if row["figure"] in PERCENT else (1.0, row["unit"])
        reference = about["reference"].get(row["figure"])
        parts.append(
            f"| {NAMES[row['figure']]}, {unit} | {scale * row['value']:.4g} | {scale * row['low']:.4g} to "
            f"{scale * row['high']:.4g} | {'' if reference is None else f'{scale * reference:.4g}'} |"
        )
    channel = own["calibration"]["channels"][0]
    truth = about.get("truth", {})
    parts += ["\nThe fitted camera:\n", f"| parameter | value | 95 % interval |{' published |' * bool(truth)}",
              f"|---|---|---|{'---|' * bool(truth)}"]  # fmt: skip
    for row in channel["parameters"]:
        name = f"{row['name'].replace('_', ' ')}, {row['unit'] or '1'}"
        shown = f"| {name} | {row['value']:.5g} | {row['low']:.5g} to {row['high']:.5g} |"
        parts.append(shown + (f" {truth[row['name']]:g} |" if row["name"] in truth else " |" * bool(truth)))
    if channel["waves"]:
        parts.append("\nWaves in the dark: " + "; ".join(
            f"{one['amplitude']:.3g} DN at ({one['along_y']:.4f}, {one['along_x']:.4f}) cycles/pixel (y, x)"
            for one in channel["waves"]
        ) + ".")  # fmt: skip
    check = own["calibration"]["checks"][0]
    judged = [row for row in check["levels"] if row["judged"]]
    inside = sum(abs(row["spatial_predicted"] - row["spatial"]) <= 1.96 * row["spatial_error"] for row in judged)
    alike = sum(row["histogram_distance"] <= row["histogram_expected"] for row in judged)
    parts += [
        f"\nPredicted and measured values of {check['judged']} levels from 2 to 90 % of saturation:\n",
        "| what | difference | limit |", "|---|---|---|",
        f"| temporal variance, rms | {100 * check['variance_rms']:.2f} %, of which sampling "
        f"{100 * check['variance_sampling']:.2f} % | 1.2 % |",
        f"| temporal variance, worst level | {100 * check['variance_worst']:.2f} % &plusmn; "
        f"{100 * check['variance_worst_sampling']:.2f} % | 3 % |",
        f"| mean, worst level | {100 * check['mean_worst']:.3f} % | 0.5 % |",
        f"| spatial variance, level with the most frames | {100 * check['spatial_at_stack']:+.1f} % | 5 % + 3 standard "
        f"errors of {100 * check['spatial_error_at_stack']:.1f} % |",
        f"| spatial variance within its interval | {inside} of {len(judged)} levels | |",
        f"| histogram within the distance expected by chance | {alike} of {len(judged)} levels | |",
    ]  # fmt: skip
    words = {"variance_worst": "the variance of a level", "variance_rms": "the variance", "mean_worst": "the mean"}
    wrong = [
        f"{words[key]}, {100 * check[key]:.2f} %"
        f"{'' if not check['within'][key] else ', by less than its sampling error'}"
        for key in words
        if check[key] > check["limits"][key]
    ]
    if wrong:
        parts.append(f"\nOutside its limit: {'; '.join(wrong)}.")
    if off := check["labels_off"]:
        parts.append(
            f"\n{off} level has a mean signal that does not fit the stated amount of light; it is predicted "
            "from its measured mean."
        )
    rows = [f"{one:.2f}" for one in _median_lines(judged)]
    parts.append(
        f"\nPower of row means over that of white noise, median of levels: {rows[0]} measured, {rows[1]} predicted; "
        f"for column means {rows[2]} and {rows[3]}.\n"
    )
    return parts


def _median_lines(rows: list[dict[str, Any]]) -> list[float]:
    keys = ("row_spectrum", "row_spectrum_predicted", "column_spectrum", "column_spectrum_predicted")
    return [sorted(row[key] for row in rows)[len(rows) // 2] for key in keys]


def main() -> None:
    asked = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    asked.add_argument("--data", type=Path)
    given = asked.parse_args()
    if given.data:
        WRITTEN.write_text(json.dumps(finite(measure(given.data)), indent=1) + "\n")
    found = json.loads(WRITTEN.read_text())
    PAGE.write_text(page(found))
    for name, own in found.items():
        plot = photon_transfer(own["calibration"]["checks"], SETS[name]["title"], SETS[name]["notice"])
        plot.save(PICTURES / f"{name}.png")


if __name__ == "__main__":
    main()
