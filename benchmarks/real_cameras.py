"""Cameras and lenses by name beside what others measured: the rows that docs/reality.md has of them.

python benchmarks/real_cameras.py --camconst FILE --lensfun FOLDER    # writes benchmarks/real_cameras.json
python benchmarks/real_cameras.py --points 500                        # also beside lensfunpy 1.18.0, if installed

The files are the user's own copies: camconst.json of RawTherapee (GPL-3), the lensfun database (CC BY-SA 3.0).
"""

from __future__ import annotations

import argparse
import json
import math
from pathlib import Path
from typing import Any

import numpy as np

from etendue.pipeline.presets import preset
from etendue_camera import spectra
from etendue_camera.cameras import bodies, camconst
from etendue_camera.cameras.lensfun import read_database
from etendue_camera.cameras.names import brand, full_name, plain
from etendue_camera.cameras.tuned import FOLDER, packaged_tuning
from etendue_camera.field.lens_calibration import Lens

WRITTEN = Path(__file__).with_name("real_cameras.json")
APERTURE = 11.0  # f-number at which only the natural fall-off is left
NORMAL = 45.0  # mm times crop factor, from which a lens is not wide
WIDTH, HEIGHT = 600, 400  # pixels of the pictures that lensfunpy corrects


def whites(path: Path) -> dict[str, Any]:
    """Return the white of D65 by body, in stops of red and blue over green: sensitivity less maker's matrix."""
    known = {plain(name): one for name, one in camconst.constants(path.read_bytes(), path.name).items()}
    edges = tuple(np.arange(380.0, 781.0, 5.0))
    light = spectra.illuminant("D65", edges)
    xyz = light @ spectra.colour_matching(edges)
    found = {}
    for name, row in bodies.sensitivities().items():
        own = known.get(plain(name))
        if own is None or own.matrix is None:
            continue
        assert row["per"] == "energy"
        ours = light @ spectra.camera_sensitivity(name, edges)[1]
        theirs = own.matrix @ xyz
        difference = np.log2(ours[[0, 2]] / ours[1]) - np.log2(theirs[[0, 2]] / theirs[1])
        found[name] = [round(float(one), 4) for one in difference]
    values = np.array(list(found.values()))
    return {"bodies": found, "rms": float(np.sqrt(np.mean(values**2))), "largest": float(np.abs(values).max())}


def full_scales() -> dict[str, Any]:
    """Return full scales of the tunings, and the published full wells of the same sensors among the packaged ones."""
    published = {}
    for row in bodies.packaged().values():
        if row["tuning"] and row["sensor"]:
            fact = preset(row["sensor"]).facts["full_well"]
            published[row["tuning"]] = (float(str(fact.value).split()[0]), fact.source)
    rows = {}
    for path in sorted(FOLDER.glob("*.json")):
        own = packaged_tuning(path.stem)
        if (charge := own.full_scale()) is not None:
            measured, source = published.get(path.stem, (None, ""))
            rows[path.stem] = {
                "tuning": round(charge, 1),
                "default": own.looks_like_a_default(),
                "measured": measured,
                "source": source,
            }
    return rows


def falls(folder: Path) -> dict[str, Any]:
    """Return measured falls to the corner of the calibrated sensor at f/11, and those of the cos4 law, in stops."""
    rows, crops = dict[str, list[float]](), []
    for lens in read_database(folder.glob("*.xml")).lenses:
        if lens.focal[0] != lens.focal[1] or not lens.vignetting:
            continue
        corner = np.array([lens.half_diagonal()])
        relative = lens.relative(corner, lens.focal[0], APERTURE, 1000.0)
        if (
            relative is None
            or relative[0] <= 0
            or min(abs(one.aperture / APERTURE - 1) for one in lens.vignetting) > 0.3
        ):
            continue
        law = 4 * math.log2(math.cos(math.atan(float(corner[0]) / lens.focal[0])))
        key = f"{full_name(lens.maker, lens.model)} on crop {lens.crop_factor:g}"
        if key not in rows:
            crops.append(lens.crop_factor)
        rows[key] = [lens.focal[0], round(float(np.log2(relative[0])), 4), round(law, 4)]
    values = np.array(list(rows.values()))
    off = values[:, 2] - values[:, 1]
    examples = sorted(rows, key=lambda one: abs(rows[one][1] - rows[one][2]))[:: max(1, len(rows) // 6)]
    long = np.array([focal * crop >= NORMAL for focal, crop in zip(values[:, 0], crops, strict=True)])
    return {
        "lenses": len(rows),
        "normal_and_long": {"lenses": int(long.sum()), "rms": float(np.sqrt(np.mean(off[long] ** 2)))},
        "wide": {"lenses": int((~long).sum()), "rms": float(np.sqrt(np.mean(off[~long] ** 2)))},
        "median": float(np.median(off)),
        "examples": {key: rows[key] for key in examples},
    }


def agreement(count: int, seed: int = 28) -> dict[str, Any]:
    """Return the largest differences from lensfunpy at random lenses, focal lengths, apertures and distances: heights
    relative to half the diagonal, relative illumination relative to itself.
    """
    import lensfunpy

    folder = Path(lensfunpy.__file__).parent / "db_files"
    own = read_database(folder.glob("*.xml")).lenses
    theirs = [one for one in lensfunpy.Database().lenses if "RECTILINEAR" in str(one.type) and one.calib_vignetting]
    random = np.random.default_rng(seed)
    worst: dict[str, list[float]] = {"distortion": [], "colours": [], "fall_off": []}
    compared = refused = 0
    while compared < count:
        one = theirs[random.integers(len(theirs))]
        lens = next((mine for mine in own if _same(mine, one)), None)
        if lens is None or not 0 < one.min_focal <= one.max_focal:
            refused += 1
            continue
        focal = float(np.float32(random.uniform(one.min_focal, one.max_focal)))
        aperture = float(np.float32((one.min_aperture or 2.0) * 2 ** random.uniform(0, 3)))
        distance = float(np.float32(10 ** random.uniform(-0.5, 3)))
        compared += 1
        _compare(lens, one, (focal, aperture, distance), worst)
    return {
        "points": compared,
        "not matched": refused,
        "lensfunpy": lensfunpy.__version__,
        "lensfun": ".".join(map(str, lensfunpy.lensfun_version)),
        **{name: {"compared": len(v), "largest": max(v), "median": float(np.median(v))} for name, v in worst.items()},
    }


def _same(mine: Lens, one: Any) -> bool:
    return (
        mine.maker == brand(one.maker)
        and mine.model == one.model.strip()
        and abs(mine.crop_factor / one.crop_factor - 1) < 1e-3
        and len(mine.vignetting) == len(one.calib_vignetting)
    )


def _compare(lens: Lens, one: Any, settings: tuple[float, float, float], worst: dict[str, list[float]]) -> None:
    import lensfunpy

    modifier = lensfunpy.Modifier(one, one.crop_factor, WIDTH, HEIGHT)
    modifier.initialize(*settings, scale=1.0, pixel_format=np.float32)
    half = lens.half_diagonal()
    scale = 2 * half / math.hypot(WIDTH, HEIGHT)  # mm per pixel
    x, y = np.arange(WIDTH // 2, WIDTH, 20), np.arange(HEIGHT // 2, HEIGHT, 14)
    centre_x, centre_y = 0.5 * (WIDTH - 1), 0.5 * (HEIGHT - 1)
    ideal = np.hypot(x - centre_x, HEIGHT // 2 - centre_y) * scale
    share = (x - centre_x) * scale / ideal
    real = lens.heights(ideal, settings[0]) * share[:, None]
    if (moved := modifier.apply_geometry_distortion()) is not None:
        theirs = (moved[HEIGHT // 2, x, 0] - centre_x) * scale
        worst["distortion"].append(float(np.abs(real[:, 1] - theirs).max() / half))
    if (moved := modifier.apply_subpixel_geometry_distortion()) is not None:
        theirs = (moved[HEIGHT // 2, x, ::-1, 0] - centre_x) * scale
        worst["colours"].append(float(np.abs(real - theirs).max() / half))
    picture = np.ones((HEIGHT, WIDTH, 3), np.float32)
    relative = lens.relative(np.array([0.0]), *settings)
    if modifier.apply_color_modification(picture) and relative is not None:
        # lensfun 0.3.4 takes a pixel's light one pixel farther out than its geometry
        radius = np.hypot(x - 0.5 * WIDTH + 1, y - 0.5 * HEIGHT + 1) * scale
        ours = lens.relative(radius, *settings)
        assert ours is not None
        worst["fall_off"].append(float(np.abs(ours * picture[y, x, 1] - 1).max()))


def main() -> None:
    asked = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    asked.add_argument("--camconst", type=Path)
    asked.add_argument("--lensfun", type=Path)
    asked.add_argument("--points", type=int)
    given = asked.parse_args()
    found = json.loads(WRITTEN.read_text()) if WRITTEN.exists() else {}
    found["full_scale"] = full_scales()
    if given.camconst:
        found["whites"] = whites(given.camconst)
    if given.lensfun:
        found["falls"] = falls(given.lensfun)
    if given.points:
        found["lensfun"] = agreement(given.points)
    WRITTEN.write_text(json.dumps(found, indent=1) + "\n")
    print(json.dumps({key: one for key, one in found.items() if key != "whites"}, indent=1))


if __name__ == "__main__":
    main()
