"""What a pair of training data costs, whether memory stays flat, and whether every worker makes the same pair.

    python benchmarks/pairs.py [--count 60] [--tiny 2000] [--exact 5]

The camera of ``etendue new`` with ``photograph``: 256 x 256 pixels, 15 bands, samples of half a pitch, tolerance 1e-3.
Every pair has its own f-number, exposure time, ISO and photograph, a JPEG of 1024 x 768 made here, which no pair before
has seen. CPU seconds of one process; pairs a second are the cores over these. ``--exact``: as many pairs with
tolerance 0 and nothing left out. ``--tiny``: memory over as many pairs of 24 x 24 pixels.
"""

from __future__ import annotations

import argparse
import os
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path

import numpy as np
from PIL import Image

from etendue.evaluation.session import Session
from etendue.session import load
from etendue_lab.pairs.drawing import BYTES, Pairs, pairs_of

OVER = ("f_number=1.8:8", "integration_time=1 ms:16 ms:log", "iso=55:1600:log")
NUMBER = 1234  # the pair that several workers make
SWAPS = {
    'use = "composite" ': 'use = "photograph"\nfile = "package:etendue_camera/data/examples/picture.png" ',
    'sensor_width = "0.48 mm"\nsensor_height = "0.36 mm"': "rows = 256\ncolumns = 256",
    'width = "0.52 mm"': 'width = "0.4 mm"',
    'spacing = "0.5 um"': 'spacing = "0.7 um"',
    '[[stages]]\nuse = "resolution"\n': "",
}


def camera(folder: Path) -> Path:
    """The pipeline that ``etendue new`` writes, with a photograph."""
    subprocess.run(
        [sys.executable, "-m", "etendue", "new", "mine", "-o", folder], check=True, stdout=subprocess.DEVNULL
    )
    text = (folder / "mine.toml").read_text()
    for old, new in SWAPS.items():
        assert old in text, old
        text = text.replace(old, new)
    (folder / "mine.toml").write_text(text)
    return folder / "mine.toml"


def photographs(folder: Path, count: int) -> Path:
    """Random colour pictures whose amplitudes fall as 1/f, like those of photographs."""
    folder.mkdir()
    height, width = 768, 1024
    falling = np.hypot(np.fft.fftfreq(height)[:, None], np.fft.rfftfreq(width))
    falling[0, 0] = 1
    draw = np.random.default_rng(1)
    base = [np.fft.irfft2(np.fft.rfft2(draw.standard_normal((height, width))) / falling) for _ in range(8)]
    for number in range(count):
        mixed = np.tensordot(draw.standard_normal((3, 8)) + draw.standard_normal(8), base, 1)
        mixed = np.roll(mixed / mixed.std(axis=(1, 2), keepdims=True), int(draw.integers(width)), axis=2)
        values = np.clip(128 + 50 * mixed, 0, 255).astype(np.uint8).transpose(1, 2, 0)
        Image.fromarray(values).save(folder / f"{number:05}.jpg", quality=92)
    return folder


def seconds_of(pairs: Pairs, numbers: range) -> list[float]:
    """CPU seconds of each pair; each with a photograph of its own."""
    found = []
    for number in numbers:
        own = replace(pairs, photographs=(pairs.photographs[number],), _session=pairs.session)
        began = time.process_time()
        own[number]
        found.append(time.process_time() - began)
    return found


def resident() -> float:
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * resource.getpagesize() / 1e6


def digest(pairs: Pairs, number: int = NUMBER) -> str:
    found: str = pairs[number].digest()
    return found


def main() -> None:
    given = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    given.add_argument("--count", type=int, default=60)
    given.add_argument("--tiny", type=int, default=2000)
    given.add_argument("--exact", type=int, default=5)
    asked = given.parse_args()
    cores = os.cpu_count() or 1
    print(f"load {os.getloadavg()[0]:.1f} on {cores} cores")
    with tempfile.TemporaryDirectory() as place:
        os.environ["ETENDUE_CACHE"] = str(Path(place, "cache"))  # nothing from earlier calls
        file = camera(Path(place))
        pictures = photographs(Path(place, "photographs"), asked.count + 3)
        pairs = pairs_of(load(file), pictures, OVER, seed=1, count=5000)
        seconds_of(pairs, range(asked.count, asked.count + 3))
        own = seconds_of(pairs, range(asked.count))
        told = f"lowest {min(own):.3f}, median {statistics.median(own):.3f}, mean {statistics.mean(own):.3f}"
        print(f"CPU s a pair: {told}; by the mean {cores / statistics.mean(own):.1f} pairs/s on {cores} cores")
        exact = replace(pairs, _session=Session(replace(pairs.pipeline, tolerance=0.0), BYTES, leave_out=False))
        if asked.exact:
            whole = statistics.median(seconds_of(exact, range(min(asked.exact, asked.count))))
            print(f"everything exact: median {whole:.3f} CPU s a pair")
        print(f"memory after {asked.count} pairs: {resident():.0f} MB")
        text = file.read_text().replace("rows = 256\ncolumns = 256", "rows = 24\ncolumns = 24")
        (file.parent / "tiny.toml").write_text(text.replace('"0.4 mm"', '"0.05 mm"'))
        tiny, early = pairs_of(load(file.parent / "tiny.toml"), pictures, OVER, seed=1, count=5000), 0.0
        tiny.session.results.clear(32 << 20)
        for number in range(asked.tiny):
            tiny[number]
            early = resident() if number == asked.tiny // 4 else early
        if asked.tiny:
            print(f"memory after {asked.tiny} tiny pairs / after a quarter of them: {resident() / early:.3f}")
        one = digest(pairs)
        with ProcessPoolExecutor(2, get_context("spawn")) as pool:
            two = list(pool.map(digest, [pairs, pairs]))
        from distributed import Client, LocalCluster

        with (
            LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster,
            Client(cluster) as client,
        ):
            many = client.gather(client.map(digest, [pairs, pairs], pure=False))
        same = {one, *two, *many} == {one}
        print(f"pair {NUMBER} from one process, two, and a cluster: {'the same bits' if same else 'OTHER BITS'}")


if __name__ == "__main__":
    main()
