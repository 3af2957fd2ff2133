"""200 points of a CMOS sweep by Pyxel, beside `pyxel_case.py`: its own models, its own Dask threads, only the image
kept.

    python benchmarks/pyxel_peer.py --python PYXELS_PYTHON [--repeats 3]

``--python`` is that of an environment with ``pip install pyxel-sim==3.0.2``. 5 point spread functions (as 5 f-numbers
make them, Airy discs at 550 nm on 5 um pixels) x 5 dark rates x 8 read noises: what Pyxel can sweep of such a camera; a
pixel pitch it cannot. Each repeat is a process of its own with two calls: the first, which imports what it needs, and
the next; wall seconds, ``.load()`` included.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

CONFIGURATION = """
observation:
  readout: {{ times: [0.01], non_destructive: false }}
  mode: product
  with_dask: true
  result_type: image
  parameters:
    - key: pipeline.photon_collection.load_psf.arguments.filename
      values: {files}
    - key: pipeline.charge_generation.simple_dark_current.arguments.dark_rate
      values: [1.0, 3.0, 10.0, 30.0, 100.0]
    - key: pipeline.charge_measurement.output_node_noise.arguments.std_deviation
      values: [1.0e-6, 2.0e-6, 3.0e-6, 4.0e-6, 5.0e-6, 6.0e-6, 7.0e-6, 8.0e-6]
cmos_detector:
  geometry: {{ row: 256, col: 256, total_thickness: 10.0, pixel_vert_size: 5.0, pixel_horz_size: 5.0 }}
  environment: {{ temperature: 300.0 }}
  characteristics:
    quantum_efficiency: 0.5
    charge_to_volt_conversion: 1.0e-6
    pre_amplification: 10.0
    full_well_capacity: 50000
    adc_bit_resolution: 12
    adc_voltage_range: [0.0, 0.5]
pipeline:
  photon_collection:
    - name: load_image
      func: pyxel.models.photon_collection.load_image
      enabled: true
      arguments: {{ image_file: {picture}, convert_to_photons: false, multiplier: 1.0 }}
    - name: load_psf
      func: pyxel.models.photon_collection.load_psf
      enabled: true
      arguments: {{ filename: {first} }}
    - {{ name: shot_noise, func: pyxel.models.photon_collection.shot_noise, enabled: true }}
  charge_generation:
    - {{ name: simple_conversion, func: pyxel.models.charge_generation.simple_conversion, enabled: true }}
    - name: simple_dark_current
      func: pyxel.models.charge_generation.simple_dark_current
      enabled: true
      arguments: {{ dark_rate: 1.0 }}
  charge_collection:
    - {{ name: simple_collection, func: pyxel.models.charge_collection.simple_collection, enabled: true }}
    - {{ name: simple_full_well, func: pyxel.models.charge_collection.simple_full_well, enabled: true }}
  charge_measurement:
    - {{ name: simple_measurement, func: pyxel.models.charge_measurement.simple_measurement, enabled: true }}
    - name: output_node_noise
      func: pyxel.models.charge_measurement.output_node_noise
      enabled: true
      arguments: {{ std_deviation: 1.0e-6 }}
  readout_electronics:
    - {{ name: simple_amplifier, func: pyxel.models.readout_electronics.simple_amplifier, enabled: true }}
    - {{ name: simple_adc, func: pyxel.models.readout_electronics.simple_adc, enabled: true }}
"""

CALLS = """
import json, sys, time
found = []
for _ in range(2):
    began = time.perf_counter()
    import pyxel
    tree = pyxel.run_mode(pyxel.load(sys.argv[1])).load()
    found.append(time.perf_counter() - began)
images = [(path, node["image"].shape) for path, node in ((n.path, n) for n in tree.subtree) if "image" in node]
print(json.dumps({"seconds": found, "images": images, "version": pyxel.__version__}))
"""


def files(folder: Path) -> tuple[list[str], str]:
    """Point spread functions of five apertures, and a picture in photons."""
    from scipy.special import j1

    paths = []
    for number in (2.0, 2.8, 4.0, 5.6, 8.0):
        at = (np.arange(25) - 12) * 5.0
        u = np.pi * np.hypot(at[:, None], at[None, :]) / (0.55 * number)
        spread = (2 * j1(np.maximum(u, 1e-9)) / np.maximum(u, 1e-9)) ** 2
        paths.append(str(folder / f"psf_{10 * number:g}.npy"))
        np.save(paths[-1], spread / spread.sum())
    picture = folder / "picture.npy"
    np.save(picture, np.random.default_rng(1).random((256, 256)) * 40000)
    return paths, str(picture)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--python", required=True, metavar="PATH")
    parser.add_argument("--repeats", type=int, default=3)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        paths, picture = files(folder)
        (folder / "case.yaml").write_text(
            CONFIGURATION.format(files=json.dumps(paths), picture=picture, first=paths[0])
        )
        runs = []
        for _ in range(given.repeats):
            done = subprocess.run(
                [given.python, "-c", CALLS, str(folder / "case.yaml")],
                cwd=folder,
                capture_output=True,
                text=True,
                check=False,
            )
            if done.returncode:
                sys.exit(done.stderr[-2000:])
            runs.append(json.loads(done.stdout.splitlines()[-1]))
    print(f"Pyxel {runs[0]['version']}, 200 points, images {runs[0]['images']}")
    for call, label in enumerate(("first call", "next call")):
        seconds = sorted(run["seconds"][call] for run in runs)
        print(f"{label}   {', '.join(f'{s:.2f}' for s in seconds)} s")


if __name__ == "__main__":
    main()
