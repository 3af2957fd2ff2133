"""What frames cost: a burst of 64 exposures of 64 x 64 pixels through noise and read-out, and one frame 64 times as
large.

    python benchmarks/burst.py [--repeats 7]

CPU time of this process, one thread, in memory, tables warm; the smallest of the repeats counts. Stages are run frame
by frame, as the bits of a frame must not depend on its neighbours: the ratio says what that costs.
"""

from __future__ import annotations

import argparse
import time

from threadpoolctl import threadpool_limits

import etendue
from etendue.contract.registry import installed_stages

FRAMES, SIDE = 64, 64
CHAIN = ("shot_noise", "full_well", "read_noise", "adc", "linearise")


def camera(side: int, frames: int) -> dict:  # type: ignore[type-arg]
    width = 4.0 * side + 20
    if "bracket" in installed_stages():
        exposure = [{"use": "bracket", "repeats": frames}, {"use": "exposure"}]
    else:  # as it was before a stage was run frame by frame
        exposure = [{"use": "exposure_series", "repeats": frames, "name": "exposure"}]
    return {
        "name": "burst",
        "precision": "float32",
        "wanted": ["linearise.mosaic_linear"],
        "keep": ["linearise.mosaic_linear"],
        "camera": {"peak_qe": [0.4, 0.5, 0.45], "pixel_pitch": 4.0, "f_number": 4.0},
        "stages": [
            {
                "use": "uniform",
                "name": "scene",
                "white_luminance": 800,
                "width": width,
                "height": width,
                "spacing": 8.0,
                "wavelength_from": 400,
                "wavelength_to": 700,
                "bin_width": 100,
            },
            {"use": "irradiance"},
            {"use": "pixel", "rows": side, "columns": side},
            {"use": "mosaic"},
            *exposure,
            *({"use": use} for use in CHAIN),
        ],
    }


def cpu(document: dict, repeats: int) -> float:  # type: ignore[type-arg]
    etendue.simulate(document, scheduler="serial")
    taken = []
    for _ in range(repeats):
        began = time.process_time()
        etendue.simulate(document, scheduler="serial")
        taken.append(time.process_time() - began)
    return min(taken)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=7)
    repeats = parser.parse_args().repeats
    with threadpool_limits(1):
        many, one = cpu(camera(SIDE, FRAMES), repeats), cpu(camera(SIDE * 8, 1), repeats)
    first, second = (
        f"{FRAMES} frames of {SIDE} x {SIDE}: {1e3 * many:.1f} ms",
        f"one of {SIDE * 8} x {SIDE * 8}: {1e3 * one:.1f} ms",
    )
    print(f"{first}; {second}; ratio {many / one:.2f}")


if __name__ == "__main__":
    main()
