"""Draw the first picture of the README: one part of the frame after each of twelve stages, samples as squares.

etendue run pipelines/paper.toml
python docs/making/opening.py paper -o docs/pictures/stages.png
"""

from __future__ import annotations

import argparse
from pathlib import Path

import xarray
from matplotlib.figure import Figure
from PIL import Image

from etendue.present.plots import pictures

SHOWN = {
    "scene.radiance": "scene",
    "falloff.irradiance": "fall-off",
    "lens.irradiance": "lens",
    "aperture.irradiance": "diffraction",
    "pixel.photon_rate": "photodiodes",
    "mosaic.photocurrent": "Bayer mosaic",
    "adc.raw": "noise, converter",
    "demosaic.rgb_camera": "demosaiced",
    "sharpen.rgb_camera": "sharpened",
    "balance.xyz_scene": "balanced",
    "display.rgb_linear": "display",
    "encode.rgb_display": "gamma",
}
TOP, LEFT, SIDE = 50, 84, 88  # of the part, samples
TIMES, ACROSS, GAP, LABEL = 2, 6, 8, 18  # dots


def drawn(archive: Path) -> Figure:
    """Draw two rows of pictures with their names above."""
    tree = xarray.open_datatree(archive / "data.zarr", engine="zarr")
    side = SIDE * TIMES
    rows = -(-len(SHOWN) // ACROSS)
    wide, high = ACROSS * (side + GAP) + GAP, rows * (side + LABEL + GAP) + GAP
    figure = Figure((wide / 100, high / 100), dpi=100)
    for number, (place, name) in enumerate(SHOWN.items()):
        row, column = divmod(number, ACROSS)
        left, top = GAP + column * (side + GAP), GAP + row * (side + LABEL + GAP) + LABEL
        stage, variable = place.split(".")
        part = pictures.drawn(tree[stage][variable])[TOP : TOP + SIDE, LEFT : LEFT + SIDE]
        axes = figure.add_axes((left / wide, 1 - (top + side) / high, side / wide, side / high))
        axes.imshow(part, interpolation="none", aspect="auto")
        axes.set_axis_off()
        figure.text(left / wide, 1 - (top - 5) / high, f"{number + 1}. {name}", fontsize=9, va="bottom")
    return figure


def main() -> None:
    """Draw it to a file, in true colour."""
    asked = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    asked.add_argument("archive", type=Path)
    asked.add_argument("-o", "--output", type=Path, required=True)
    given = asked.parse_args()
    drawn(given.archive).savefig(given.output)
    Image.open(given.output).convert("RGB").save(given.output, optimize=True)
    print(f"{given.output}  {given.output.stat().st_size / 1e3:.0f} kB")


if __name__ == "__main__":
    main()
