"""A simulated camera measured by etendue and by the independent reference program of the standard, side by side.

    python benchmarks/emva_peer.py [--python PEERS_PYTHON] [--seed 0]

The frames come from the product's own stages (exposure, shot noise, full well, read noise, converter); both programs
read the same folder: pictures of 16 bits and the text descriptor of EMVA reference sets. ``--python`` is that of an
environment with ``pip install 'numpy<2' emva1288==1.0.2``; without it one is made in a temporary folder, and where that
fails the comparison is skipped with the reason (exit code 0). Exit code 1: a value of the reference program is outside
etendue's 95 % interval, widened by half for the program's own error from the same frames.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import venv
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from etendue.compute.random import philox
from etendue.compute.tables import PatternRandom
from etendue.contract.arrays.grid import Grid, Line
from etendue_camera.electronics import dynamic_range
from etendue_camera.electronics.stages.exposure import Exposure, FullWell, ShotNoise
from etendue_camera.electronics.stages.read_out import Adc, ReadNoise
from etendue_lab.calibrate.study import calibrated
from etendue_lab.emva.frames import measured

SIDE, EFFICIENCY, STACK = 192, 0.5, 24
CAMERA = {
    "pixel_pitch": 5.4, "aperture_fraction": 1.0, "full_well_density": 1000.0, "bits": 12, "black_level": 128.0,
    "dark_current_density": 2e-9, "read_noise": 8.0, "dsnu": 3.0, "prnu": 0.01, "dark_nonuniformity": 0.1,
    "conversion_gain": 0.23,
}  # fmt: skip
TIMES = np.linspace(0.002, 0.1, 34)
FULL_TIME = 0.08  # s, when the light saturates
PEER = """
import json, logging, sys, warnings
warnings.simplefilter("ignore")
logging.disable(logging.CRITICAL)
from emva1288.process import Data1288, LoadImageData, ParseEmvaDescriptorFile, Results1288
images = ParseEmvaDescriptorFile(sys.argv[1], path=sys.argv[2]).images
found = Results1288(Data1288(LoadImageData(images).data).data)
print(json.dumps({"gain": found.K, "quantum_efficiency": found.QE / 100, "read_noise": found.sigma_d,
    "saturation_capacity": found.u_e_sat, "dsnu": found.DSNU1288, "prnu": found.PRNU1288 / 100,
    "dark_current": found.u_I_mean if found.u_I_mean == found.u_I_mean else None}))
"""
INSTALLED = ("numpy<2", "emva1288==1.0.2")


def made(folder: Path, seed: int) -> dict[str, float]:
    """Write the frames and their descriptor; return what was put in."""

    def stage(kind: Any, **own: Any) -> Any:
        return kind(**{key: value for key, value in {**CAMERA, **own}.items() if key in kind.__dataclass_fields__})

    grid = Grid.of({"y": Line(SIDE, 0.0, 1.0, "1", (0.0, 5.4)), "x": Line(SIDE, 0.0, 1.0, "1", (0.0, 5.4))})
    sensor, adc = PatternRandom(str(seed).encode(), grid, "float32"), stage(Adc)
    rate = adc.saturation() / FULL_TIME
    lines = ["v 3.0", f"n {CAMERA['bits']} {SIDE} {SIDE}"]
    number = 0

    def take(time: float, light: float, count: int) -> None:
        nonlocal number
        exposed = stage(Exposure, integration_time=float(time)).run(np.full((SIDE, SIDE), light, np.float32), sensor)
        charge = np.repeat(exposed["expected_charge"][None], count, axis=0)
        for kind in (ShotNoise, FullWell, ReadNoise, Adc):
            random = {"rng": philox(f"{seed}|{number}|{kind.__name__}".encode())}
            given = random if kind in (ShotNoise, ReadNoise) else {}
            given |= {"rng_sensor": sensor} if kind is ReadNoise else {}
            (charge,) = stage(kind).run(charge, **given).values()
        lines.append(f"b {time * 1e9:.0f} {light * time / EFFICIENCY:.3f}" if light else f"d {time * 1e9:.0f}")
        for own in charge:
            Image.fromarray(np.asarray(own, np.uint16)).save(folder / f"{number:04d}.tif")
            lines.append(f"i {number:04d}.tif")
            number += 1

    for time in TIMES:
        take(time, rate, 2)
        take(time, 0.0, 2)
    half = float(TIMES[np.searchsorted(TIMES, FULL_TIME / 2)])
    take(half, rate, STACK)
    take(half, 0.0, STACK)
    (folder / "set.txt").write_text("\n".join(lines) + "\n")
    return {
        "gain": adc.dn_per_electron(),
        "quantum_efficiency": EFFICIENCY,
        "read_noise": CAMERA["read_noise"],
        "dark_current": float(dynamic_range.dark_electrons(CAMERA["dark_current_density"], 5.4**2, 1.0)),
        "dsnu": CAMERA["dsnu"],
        "prnu": CAMERA["prnu"],
        "saturation_capacity": adc.saturation(),
    }


def peer(python: Path, folder: Path) -> dict[str, float]:
    """Return the figures of the reference program."""
    done = subprocess.run(
        [str(python), "-c", PEER, str(folder / "set.txt"), str(folder)], capture_output=True, text=True, timeout=600
    )
    if done.returncode:
        raise RuntimeError(f"the reference program failed: {done.stderr.strip().splitlines()[-1]}")
    return dict(json.loads(done.stdout.splitlines()[-1]))


def environment(folder: Path) -> Path:
    """Make an environment with the reference program; raise RuntimeError with the reason where that fails."""
    venv.create(folder, with_pip=True)
    python = folder / "bin" / "python"
    done = subprocess.run(
        [str(python), "-m", "pip", "install", "-q", *INSTALLED], capture_output=True, text=True, timeout=600
    )
    if done.returncode:
        raise RuntimeError(f"{' '.join(INSTALLED)} cannot be installed: {done.stderr.strip().splitlines()[-1]}")
    return python


def main() -> int:
    asked = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    asked.add_argument("--python", type=Path)
    asked.add_argument("--seed", type=int, default=0)
    given = asked.parse_args()
    with tempfile.TemporaryDirectory() as place:
        try:
            python = given.python or environment(Path(place) / "peer")
            folder = Path(place) / "frames"
            folder.mkdir()
            true = made(folder, given.seed)
            theirs = peer(python, folder)
        except (RuntimeError, OSError, subprocess.SubprocessError) as error:
            print(f"skipped: {error}")
            return 0
        ours = {one["figure"]: one for one in measured(folder / "set.txt", None, None)["channels"][0]["figures"]}
        document, _ = calibrated(folder / "set.txt")
        fitted = {one["name"]: one for one in document["channels"][0]["parameters"]}
    print(f"{'figure':20s} {'put in':>9s} {'emva':>9s}  {'95 % interval':22s} {'emva1288':>9s} {'calibrate':>9s}")
    beyond = []
    for name, value in true.items():
        one, other, own = ours[name], theirs.get(name), fitted.get(name)
        interval = f"{one['low']:.5g} to {one['high']:.5g}"
        shown = [f"{other:9.5g}" if other is not None else 9 * " ", f"{own['value']:9.5g}" if own else ""]
        print(f"{name:20s} {value:9.5g} {one['value']:9.5g}  {interval:22s} {' '.join(shown)}")
        if other is not None and abs(other - one["value"]) > 1.5 * max(
            one["high"] - one["value"], one["value"] - one["low"]
        ):
            beyond.append(name)
    print(f"the reference program differs by more than 1.5 half intervals: {', '.join(beyond) or 'nowhere'}")
    return 1 if beyond else 0


if __name__ == "__main__":
    sys.exit(main())
