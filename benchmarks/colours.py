"""Colour through the whole camera, and what its steps cost.

    python benchmarks/colour.py [--plot FILE]

1. The 24 patches of the ColorChecker under five lights, through pipelines/colour.toml, noise included: CIEDE2000
   between the mean of each patch and its true colour, for our fitted matrix, for peers fitted by colour-science to the
   same camera values, and without a matrix. The truth is reflectance x light x observer, in the same bins.
2. What the reader sees in the end: the encoded picture, decoded again, against the truth adapted to D65 the same way.
3. Matrices, adaptation, Lab, CIEDE2000 and encodings: error against 60-digit values or colour-science, milliseconds
   beside colour-science.
"""

from __future__ import annotations

import argparse
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import etendue
from etendue_camera import spectra
from etendue_camera.colour import difference, encoding, matrices

PIPELINE = Path(__file__).parent.parent / "pipelines" / "colour.toml"
LIGHTS = ("D65", "D50", "A", "FL2", "FL11")
EDGES = tuple(float(w) for w in range(380, 785, 5))


def patches(picture: Any) -> Any:
    """Mean of the inner half of each patch: (24, channel)."""
    rows, columns = picture.shape[-2:]
    size = min(columns / 6, rows / 4)
    pitch = 0.94 * size  # as the chart is drawn
    found = []
    for row in range(4):
        for column in range(6):
            y, x = rows / 2 + (row - 1.5) * pitch, columns / 2 + (column - 2.5) * pitch
            half = 0.25 * pitch
            found.append(
                picture[:, round(y - half) : round(y + half), round(x - half) : round(x + half)].mean(axis=(1, 2))
            )
    return np.array(found)


def truth(light: str) -> tuple[Any, Any]:
    """XYZ of the patches and of the white under a light, white Y = 1."""
    spd = spectra.illuminant(light, EDGES)
    cmf = spectra.colour_matching(EDGES)
    white = spd @ cmf
    return (spectra.colorchecker(EDGES)[1] * spd) @ cmf / white[1], white / white[1]


def apart(xyz: Any, true: Any, white: Any) -> Any:
    """CIEDE2000 of each patch."""
    return difference.delta_e_2000(difference.lab(xyz.T, white), difference.lab(true.T, white))


def best(function: Callable[[], Any], repeats: int = 9) -> float:
    shortest = float("inf")
    for _ in range(repeats):
        began = time.thread_time()
        function()
        shortest = min(shortest, time.thread_time() - began)
    return 1e3 * shortest


def camera(plot: Path | None) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        import colour as library
    tree = etendue.simulate(PIPELINE, illuminant=list(LIGHTS))
    print("CIEDE2000 of the 24 patches, scene light to xyz_scene (noise included): mean / largest")
    heads = ("ours", "Cheung 2004", "Finlayson 15", "D65 matrix", "no matrix")
    print(f"{'light':6s} " + " ".join(f"{head:>13s}" for head in heads) + f" {'residual':>9s} {'cond':>6s}")
    fixed = tree["colour_fit"].colour_matrix.sel(illuminant="D65").values
    table, drawn = {}, []
    for light in LIGHTS:
        at = {"illuminant": light}
        true, white = truth(light)
        linear = patches(tree["demosaic"].rgb_camera.sel(at).values.astype(float))
        balanced = linear / tree["balance_mosaic"].white.sel(at).values
        ours = patches(tree["camera_to_xyz"].xyz_scene.sel(at).values.astype(float))
        ways = {"ours": ours}
        for method, terms in (("Cheung 2004", {"terms": 3}), ("Finlayson 2015", {"degree": 2})):
            ways[method] = library.characterisation.colour_correction(balanced, balanced, true, method=method, **terms)
        ways["D65 matrix"] = balanced @ fixed.T / (fixed @ np.ones(3)) * white
        ways["no matrix"] = balanced * white
        differences = {name: apart(xyz, true, white) for name, xyz in ways.items()}
        table[light] = differences["ours"]
        drawn.append((light, true, ours, white))
        text = [f"{differences[name].mean():5.2f} / {differences[name].max():5.2f}" for name in ways]
        residual, condition = (float(tree["colour_fit"][name].sel(at)) for name in ("fit_residual", "fit_condition"))
        print(f"{light:6s} " + " ".join(f"{t:>13s}" for t in text) + f" {residual:9.4f} {condition:9.2f}")
    print(
        "(ours keeps white exact and is fitted to reflectances, before any picture is taken; the peers are fitted to "
        "the picture itself)"
    )
    print("\nours by patch")
    print("      " + " ".join(f"{i:4d}" for i in range(1, 25)))
    for light, values in table.items():
        print(f"{light:6s}" + " ".join(f"{v:4.1f}" for v in values))
    print(
        "\nthe encoded picture, decoded, against the truth adapted to D65 (CAT16): mean / largest / patches beyond the "
        "gamut"
    )
    target = matrices.xyz_from_xy(matrices.D65_XY)
    for light in LIGHTS:
        at = {"illuminant": light}
        true, white = truth(light)
        adapted = true @ matrices.von_kries_matrix(white, target, matrices.TRANSFORMS["cat16"]).T
        shown = (
            encoding.srgb_decode(patches(tree["encode"].rgb_display.sel(at).values.astype(float)))
            @ matrices.RGB_TO_XYZ_SRGB.T
        )
        found = apart(shown, adapted, target)
        outside = int(np.sum(np.any((adapted @ np.linalg.inv(matrices.RGB_TO_XYZ_SRGB).T < 0), axis=1)))
        print(f"{light:6s} {found.mean():5.2f} / {found.max():5.2f} / {outside}")
    if plot:
        draw(drawn, plot)
        print(f"drawn: {plot}")


def draw(rows: list[Any], file: Path) -> None:
    """Truth (left half of each patch) and camera (right half), as a viewer adapted to each light sees them."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    target = matrices.xyz_from_xy(matrices.D65_XY)
    figure, axes = plt.subplots(len(rows), 1, figsize=(12, 1.1 * len(rows)), layout="constrained")
    for axis, (light, true, ours, white) in zip(axes, rows, strict=True):
        to_rgb = np.linalg.inv(matrices.RGB_TO_XYZ_SRGB) @ matrices.von_kries_matrix(
            white, target, matrices.TRANSFORMS["cat16"]
        )
        strip = np.stack([true @ to_rgb.T, ours @ to_rgb.T], axis=1).reshape(1, 48, 3)
        axis.imshow(encoding.srgb_encode(np.clip(strip, 0, 1)), aspect="auto")
        axis.set(yticks=[], xticks=np.arange(0.5, 48, 2), xticklabels=range(1, 25))
        axis.set_ylabel(light)
    figure.savefig(file, dpi=110)


def costs() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        import colour as library
    rng = np.random.default_rng(5)
    picture = rng.uniform(0, 1, (3, 256, 256)).astype(np.float32)
    last = np.moveaxis(picture, 0, -1).astype(float)
    white = matrices.xyz_from_xy(matrices.D65_XY)
    a = difference.lab(picture, white)
    b = difference.lab(picture[::-1].copy(), white)
    a_last, b_last = (np.moveaxis(v, 0, -1).astype(float) for v in (a, b))
    space = library.RGB_COLOURSPACES["sRGB"]
    light = spectra.illuminant("A", EDGES) @ spectra.colour_matching(EDGES)
    light = light / light[1]
    adapt = matrices.von_kries_matrix(light, white, matrices.TRANSFORMS["cat16"])
    steps: dict[str, tuple[Callable[[], Any], Callable[[], Any], float]] = {
        "RGB to XYZ": (
            lambda: matrices.apply_matrix(matrices.RGB_TO_XYZ_SRGB, picture),
            lambda: library.RGB_to_XYZ(last, space, apply_cctf_decoding=False),
            5e-4,
        ),
        "sRGB encoding": (lambda: encoding.srgb_encode(picture), lambda: space.cctf_encoding(last), 2e-6),
        "BT.709 encoding": (
            lambda: encoding.bt709_encode(picture),
            lambda: library.cctf_encoding(last, function="ITU-R BT.709"),
            2e-6,
        ),
        "Lab": (lambda: difference.lab(picture, white), lambda: library.XYZ_to_Lab(last, matrices.D65_XY), 2e-3),
        "CIEDE2000": (
            lambda: difference.delta_e_2000(a, b),
            lambda: library.delta_E(a_last, b_last, method="CIE 2000"),
            2e-2,
        ),
        "von Kries (CAT16)": (
            lambda: matrices.apply_matrix(adapt, picture),
            lambda: library.adaptation.chromatic_adaptation_VonKries(last, light, white, transform="CAT16"),
            2e-5,
        ),
    }
    heads = f"{'ours, ms':>9s} {'colour-science, ms':>19s} {'ratio':>6s} {'largest difference':>19s} {'bound':>8s}"
    print(f"\n{'256 x 256, float32, one thread':34s} {heads}")
    for name, (ours, theirs, bound) in steps.items():
        one, other = np.asarray(ours()), np.asarray(theirs())
        other = np.moveaxis(other, -1, 0) if other.ndim == 3 else other
        far = float(np.abs(one - other).max())
        mine, peer = best(ours), best(theirs)
        print(f"{name:34s} {mine:9.3f} {peer:19.2f} {peer / mine:6.1f} {far:19.1e} {bound:8.0e}")
        assert far <= bound, name


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--plot", type=Path, help="draw the patches: truth beside camera, a row a light")
    arguments = parser.parse_args()
    camera(arguments.plot)
    costs()


if __name__ == "__main__":
    main()
