"""Demosaicers against truth and against the clock: every installed one, and colour-demosaicing's own as peers.

    python benchmarks/demosaic.py --pictures FOLDER [--samples] [--plot demosaic.png]

FOLDER holds ``kodak/`` and ``mcmaster/`` with pictures of the Kodak PhotoCD and McMaster sets, PNG or TIFF, 8 bit.
``--samples`` adds the sample pictures that scikit-learn (china, flower) and scikit-image (astronaut, coffee, chelsea,
rocket) bring, where they are installed. Without pictures only speeds are measured. Peers need colour-demosaicing.

A picture is mosaicked as GRBG in single precision, 1 at 255; the result is rounded and clipped to 8 bit, and 10 pixels
at the border are left out. CPSNR is that of all three channels together, and the mean of a set is that of its pictures'
values. Speed is that of one thread, by the shortest thread CPU time of five or, where these are short, of as many as
take a tenth of a second; freed memory is kept, as in a run.
"""

from __future__ import annotations

import argparse
import importlib.util
import math
import time
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from etendue.contract.registry import installed_stages
from etendue.contract.stage import arguments_of
from etendue.run.memory import keep_freed_memory
from etendue_camera.sensor import cfa

PATTERN, BORDER, REPEAT, ENOUGH = "GRBG", 10, 5, 0.1
LEFT_OUT = {"demosaic_any"}  # bilinear on a Bayer array
SAMPLES = {
    "sklearn": ("datasets/images", ["china.jpg", "flower.jpg"]),
    "skimage": ("data", ["astronaut.png", "coffee.png", "chelsea.png", "rocket.jpg"]),
}
PEERS = {"bilinear": "bilinear", "Malvar 2004": "Malvar2004", "Menon 2007": "Menon2007"}
PEER = "colour-demosaicing, "

Method = Callable[[np.ndarray], np.ndarray]


@dataclass
class Row:
    """What was found about one method: CPSNR of each picture by set, Mpixel/s at 512 x 512 and on all pictures."""

    speed: float = math.nan
    cpsnr: dict[str, list[float]] = field(default_factory=dict)
    seconds: dict[str, float] = field(default_factory=dict)
    pixels: dict[str, float] = field(default_factory=dict)

    def mean(self, name: str) -> float:
        return float(np.mean(self.cpsnr[name])) if name in self.cpsnr else math.nan

    def rate(self, *names: str) -> float:
        """Mpixel/s over these sets, all without names."""
        names = names or tuple(self.seconds)
        seconds = sum(self.seconds.get(name, math.nan) for name in names)
        return sum(self.pixels.get(name, math.nan) for name in names) / seconds / 1e6 if seconds else math.nan


# -- methods


def stages() -> Iterator[tuple[str, Method]]:
    """Every installed demosaicer, from whichever distribution."""
    installed = installed_stages()
    for name in installed.names():
        if not name.startswith("demosaic_") or name in LEFT_OUT:
            continue
        kind = installed.load(name)
        yield name, _method(kind(pattern=PATTERN))


def _method(stage: Any) -> Method:
    prepared = stage.prepare({}) if hasattr(stage, "prepare") else None
    asked = arguments_of(type(stage))

    def run(raw: np.ndarray) -> np.ndarray:
        known = {"mosaic_linear": raw, "y": np.arange(raw.shape[0]), "x": np.arange(raw.shape[1]), "prepared": prepared}
        return stage.run(**{name: known[name] for name in asked})["rgb_camera"]

    return run


def peers() -> Iterator[tuple[str, Method]]:
    if importlib.util.find_spec("colour_demosaicing") is None:
        print("colour-demosaicing is not installed: no peers")
        return
    with warnings.catch_warnings(), np.printoptions():
        warnings.simplefilter("ignore")
        import colour_demosaicing
    for name, suffix in PEERS.items():
        function = getattr(colour_demosaicing, f"demosaicing_CFA_Bayer_{suffix}")
        yield PEER + name, lambda raw, function=function: np.moveaxis(function(raw, PATTERN), -1, 0)


# -- pictures


def pictures(folder: Path | None, samples: bool) -> dict[str, dict[str, np.ndarray]]:
    """Sets of (3, y, x) pictures, float32, 1 at 255."""
    found: dict[str, dict[str, np.ndarray]] = {}
    for name in ("kodak", "mcmaster"):
        files = (
            sorted(p for p in (folder / name).glob("*") if p.suffix.lower() in (".png", ".tif", ".tiff"))
            if folder
            else []
        )
        if files:
            found[name] = {file.stem: _read(file) for file in files}
        else:
            print(f"no {name} pictures" + (f" in {folder / name}" if folder else ": give --pictures FOLDER"))
    if samples:
        for package, (place, names) in SAMPLES.items():
            spec = importlib.util.find_spec(package)
            if spec is None or not spec.submodule_search_locations:
                print(f"{package} is not installed: its sample pictures are left out")
                continue
            home = Path(spec.submodule_search_locations[0]) / place
            found.setdefault("samples", {}).update({n: _read(home / n) for n in names})
    return found


def _read(file: Path) -> np.ndarray:
    if file.suffix.lower() in (".tif", ".tiff"):
        import tifffile

        picture = tifffile.imread(file)
    else:
        from PIL import Image

        picture = np.asarray(Image.open(file).convert("RGB"))
    return np.ascontiguousarray(np.moveaxis(picture[..., :3], -1, 0), np.float32) / np.float32(255)


# -- measures


def cpsnr(found: np.ndarray, truth: np.ndarray) -> float:
    inner = np.s_[:, BORDER:-BORDER, BORDER:-BORDER]
    codes = np.clip(np.round(found[inner].astype(float) * 255), 0, 255)
    return -10 * math.log10(np.square(codes / 255 - truth[inner]).mean())


def shortest(method: Method, raw: np.ndarray) -> tuple[float, np.ndarray]:
    """Thread CPU seconds, the shortest of several, and the result."""
    taken: list[float] = []
    while len(taken) < REPEAT or sum(taken) < ENOUGH:
        start = time.thread_time()
        found = method(raw)
        taken.append(time.thread_time() - start)
    return min(taken), found


def measured(method: Method, sets: dict[str, dict[str, np.ndarray]]) -> Row:
    row = Row()
    plain = np.random.default_rng(0).random((512, 512), np.float32)
    method(plain)
    row.speed = plain.size / shortest(method, plain)[0] / 1e6
    for name, members in sets.items():
        row.cpsnr[name], row.seconds[name], row.pixels[name] = [], 0.0, 0.0
        for picture in members.values():
            seconds, found = shortest(method, cfa.pick(picture, PATTERN))
            row.cpsnr[name].append(cpsnr(found, picture))
            row.seconds[name] += seconds
            row.pixels[name] += picture[0].size
    return row


# -- reports


def table(rows: dict[str, Row], sets: dict[str, dict[str, np.ndarray]]) -> None:
    heads = [f"{name} ({len(members)}), dB" for name, members in sets.items()]
    print(
        "\n"
        + f"{'method':<32}"
        + "".join(f" | {head:^22}" for head in heads)
        + f" | {'Mpixel/s 512^2':>14} | {'on pictures':>11}"
    )
    for method, row in rows.items():
        cells = [f"{np.mean(v):5.2f} ({min(v):5.2f}..{max(v):5.2f})" for v in row.cpsnr.values()]
        print(
            f"{method:<32}"
            + "".join(f" | {cell:^22}" for cell in cells)
            + f" | {row.speed:14.1f} | {row.rate():11.1f}".replace("nan", "  -")
        )


def claims(rows: dict[str, Row], sets: dict[str, dict[str, np.ndarray]]) -> None:
    """Bound, measured, and the same of a peer on the same pictures in the same run."""
    menon = rows.get(PEER + "Menon 2007", Row())
    print("\n" + f"{'claim':<66} | {'bound':>7} | {'measured':>8} | {'peer':>8} |")

    def line(claim: str, bound: float, value: float, peer: float) -> None:
        verdict = "not measured" if math.isnan(bound) or math.isnan(value) else "held" if value >= bound else "MISSED"
        text = [("-" if math.isnan(v) else f"{v:.2f}").rjust(w) for v, w in ((bound, 7), (value, 8), (peer, 8))]
        print(f"{claim:<66} | {' | '.join(text)} | {verdict}")

    for name, kodak, mcmaster, rate in (
        ("demosaic_directional", 39.8, 34.6, 10.0),
        ("demosaic_residual", 40.2, 36.0, 1.0),
    ):
        if name not in rows:
            print(f"{name} is not installed")
            continue
        row = rows[name]
        line(f"{name}: Kodak, dB; peer Menon 2007", kodak, row.mean("kodak"), menon.mean("kodak"))
        line(f"{name}: McMaster, dB; peer Menon 2007", mcmaster, row.mean("mcmaster"), menon.mean("mcmaster"))
        line(
            f"{name}: both, Mpixel/s; peer Menon 2007",
            rate,
            row.rate("kodak", "mcmaster"),
            menon.rate("kodak", "mcmaster"),
        )
        line(f"{name}: 512 x 512, Mpixel/s; peer Menon 2007", rate, row.speed, menon.speed)
    if "demosaic_directional" in rows:
        row = rows["demosaic_directional"]
        if "samples" in sets:
            line(
                "demosaic_directional: samples, dB, at least Menon's",
                menon.mean("samples"),
                row.mean("samples"),
                menon.mean("samples"),
            )
            ratio = row.rate("samples") / menon.rate("samples")
            line("demosaic_directional: samples, speed over Menon's", 20.0, ratio, 1.0)
        line("demosaic_directional: 512 x 512, speed over Menon's", 20.0, row.speed / menon.speed, 1.0)
    for name, bound, peer in (("demosaic_bilinear", 120.0, "bilinear"), ("demosaic_malvar", 50.0, "Malvar 2004")):
        if name in rows:
            other = rows.get(PEER + peer, Row())
            line(f"{name}: 512 x 512, Mpixel/s; peer {peer}", bound, rows[name].speed, other.speed)


def agreement(methods: dict[str, Method]) -> None:
    """Where ours and a peer are the same method, they are the same numbers."""
    raw = np.random.default_rng(1).random((64, 66))
    print("\n" + f"{'the same method as':<44} | largest difference, double precision, 10 pixels from the border")
    for name, peer in (
        ("demosaic_bilinear", "bilinear"),
        ("demosaic_malvar", "Malvar 2004"),
        ("demosaic_menon", "Menon 2007"),
    ):
        if name in methods and PEER + peer in methods:
            inner = np.s_[:, BORDER:-BORDER, BORDER:-BORDER]
            difference = np.abs(methods[name](raw) - methods[PEER + peer](raw))[inner].max()
            print(f"{name + ': ' + PEER + peer:<44} | {difference:.1e}")


def plot(rows: dict[str, Row], sets: dict[str, dict[str, np.ndarray]], file: Path) -> None:
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    size = (5.5 * len(sets), 5.0)
    figure, axes = pyplot.subplots(
        1, len(sets), figsize=size, sharex=True, sharey=True, squeeze=False, layout="constrained"
    )
    looks = {False: {"marker": "o", "color": "C0"}, True: {"marker": "s", "color": "C3", "mfc": "none"}}
    for axis, name in zip(axes[0], sets, strict=True):
        for method, row in rows.items():
            peer, place = method.startswith(PEER), (1e3 / row.rate(name), row.mean(name))
            axis.semilogx(*place, **looks[peer])
            label = method.removeprefix(PEER).removeprefix("demosaic_").replace("_", " ")
            how = {"ha": "center", "va": "top"} if peer else {"ha": "left", "va": "center"}
            axis.annotate(label, place, (0, -6) if peer else (6, 0), textcoords="offset points", fontsize=8, **how)
        axis.set(title=f"{name}, {len(sets[name])} pictures", xlabel="ns per pixel, one thread")
        axis.margins(0.15, 0.08)
        axis.grid(alpha=0.3, which="both")
    axes[0, 0].set_ylabel("mean CPSNR, dB")
    for peer, label in ((False, "etendue and its plugins"), (True, "colour-demosaicing")):
        axes[0, 0].plot([], [], linestyle="", label=label, **looks[peer])
    axes[0, 0].legend(loc="lower right", fontsize=8)
    figure.savefig(file, dpi=120)
    print(f"\n{file}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--pictures", type=Path, metavar="FOLDER", help="with kodak/ and mcmaster/ in it")
    parser.add_argument(
        "--samples", action="store_true", help="sample pictures of scikit-image and scikit-learn, where installed"
    )
    parser.add_argument("--plot", type=Path, metavar="FILE", help="error against run time, as a picture")
    arguments = parser.parse_args()
    keep_freed_memory()
    sets = pictures(arguments.pictures, arguments.samples)
    methods = {**dict(stages()), **dict(peers())}
    rows = {name: measured(method, sets) for name, method in methods.items()}
    table(dict(sorted(rows.items(), key=lambda item: (item[0].startswith(PEER), -item[1].speed))), sets)
    agreement(methods)
    claims(rows, sets)
    if arguments.plot and sets:
        plot(rows, sets, arguments.plot)


if __name__ == "__main__":
    main()
