"""What figures of a camera do not see: every stage is changed alone, and figures that stay are held against the
pictures that change.

In:  nothing.
Out: a line for each change: by how much raw frames and display values moved (rms, of their spread and of white), then
     by figure ``moved``, ``marked`` where the figure stayed and names the stage, or ``-`` where it stayed and does not.

    python benchmarks/unseen.py
"""

import copy

import numpy as np

import etendue

FIGURES = {
    "mtf50": "resolution",
    "information_capacity": "detail_information",
    "mean_snr": "exposure_report",
    "dr_emva": "dynamic_range",
    "dr_elgamal": "dynamic_range",
    "snr_18": "exposure_numbers",
}
CAMERA = {
    "f_number": 4.0,
    "focal_length": "8 mm",
    "integration_time": "6 ms",
    "illuminant": "D65",
    "pixel_pitch": 2.8,
    "peak_qe": [0.36, 0.44, 0.4],
    "crosstalk": "through_filter",
    "full_well_density": "2000 electron um-2",
    "read_noise": 5.0,
    "dsnu": 1.0,
    "bits": 12,
}
EDGE = {
    "use": "slanted_edge",
    "name": "scene",
    "white_luminance": 4000.0,
    "width": 400.0,
    "height": 400.0,
    "spacing": 0.7,
    "wavelength_from": 400.0,
    "wavelength_to": 700.0,
    "bin_width": 50.0,
}
CHAIN = (
    "irradiance",
    "optical_filter",
    "falloff",
    "diffraction",
    "glare",
    "birefringent",
    "diffusion",
    "pixel",
    "mosaic",
    "crosstalk",
    "defects",
    "exposure",
    "shot_noise",
    "full_well",
    "read_noise",
    "line_pattern",
    "adc",
    "stuck_pixels",
    "linearise",
    "white",
    "balance_mosaic",
    "demosaic_bilinear",
    "denoise",
    "sharpen",
    "colour_fit",
    "camera_to_xyz",
    "balance",
    "display",
    *dict.fromkeys(FIGURES.values()),
)
GIVEN = {
    "optical_filter": {"cut_off": 690.0},
    "glare": {"fraction": 0.02},
    "birefringent": {"separation_x": 0.5, "separation_y": 0.5},
    "pixel": {"rows": 100, "columns": 100},
    "defects": {"hot": 1e-4, "dead": 0.0},
    "line_pattern": {"row_noise": 1.0},
    "stuck_pixels": {"stuck": 1e-4},
    "sharpen": {"strength": 0.05},
}
CHANGES = {
    "scene": {"illuminant": "A"},
    "optical_filter": {"cut_off": 560.0},
    "diffraction": {"f_number": 5.6},
    "glare": {"fraction": 0.2},
    "birefringent": {"separation_x": 2.8},
    "diffusion": {"diffusion_depth": 30.0},
    "pixel": {"aperture_fraction": 0.5},
    "crosstalk": {"crosstalk": "per_plane"},
    "defects": {"hot": 0.05},
    "exposure": {"dark_current_density": 1e-6},
    "read_noise": {"read_noise": 30.0},
    "line_pattern": {"row_noise": 30.0},
    "adc": {"bits": 8},
    "full_well": {"full_well_density": "500 electron um-2"},
    "stuck_pixels": {"stuck": 0.05},
    "demosaic_bilinear": {"use": "demosaic_residual", "name": "demosaic_bilinear"},
    "denoise": None,
    "sharpen": {"strength": 0.5},
}
QUANTITIES = {*CAMERA, "aperture_fraction", "diffusion_depth", "dark_current_density"}


def run(changed: str = ""):
    change = CHANGES.get(changed, {}) if changed else {}
    camera, tables = dict(CAMERA), copy.deepcopy(GIVEN)
    if change and set(change) <= QUANTITIES:
        camera |= change
    elif change:
        tables[changed] = tables.get(changed, {}) | change
    names = [name for name in CHAIN if not (name == changed and change is None)]
    stages = [EDGE, *({"use": name, **tables.get(name, {})} for name in names)]
    return etendue.simulate(
        {"name": "unseen", "seed": 1, "tolerance": 0, "camera": camera, "stages": stages}, leave_out=False
    )


def last(tree, name: str) -> float:
    return float(np.ravel(tree[FIGURES[name]][name].values)[-1])


def main() -> None:
    before = run()
    raw, shown = before["adc"].raw.values.astype(float), before["display"].rgb_linear.values
    print(f"{'changed':18s} {'raw':>6s} {'shown':>6s}  " + "  ".join(f"{name:>20s}" for name in FIGURES))
    for changed in CHANGES:
        after = run(changed)
        moved = [np.sqrt(np.mean((after["adc"].raw.values - raw) ** 2)) / raw.std()]
        moved.append(np.sqrt(np.mean((after["display"].rgb_linear.values - shown) ** 2)))
        words = []
        for name, stage in FIGURES.items():
            named = str(before[stage][name].attrs.get("not_in_it", "")).split(", ")
            words.append("moved" if last(after, name) != last(before, name) else "marked" if changed in named else "-")
        print(f"{changed:18s} {moved[0]:6.3f} {moved[1]:6.3f}  " + "  ".join(f"{word:>20s}" for word in words))


if __name__ == "__main__":
    main()
