"""Sharpening, deconvolution and denoising on an edge and a texture: error against run time, gain in MTF50, price in
noise.

    python benchmarks/restoration.py [--pictures FOLDER]

Scene: overlapping discs of all sizes above a slanted edge, 160 x 160 pixels of 4 um, drawn 6 times finer. Camera:
diffraction at f/4 and 0.55 um, charge diffusion of 1.2 um, a pixel aperture of 0.86; then the noise of a full well of
16000, 2000 and 300 electrons.
Truth: the scene itself, band-limited to the pixel's Nyquist frequency. Every method sees the same picture; peers are
the usual few lines. With --pictures (photographs, taken as drawn 4 times finer) the error is the mean over them.
Prints the error, the gain in MTF50 and the price in noise (predicted, and measured on a noise-free edge and on a flat
field), and CPU time; then the claims with their bounds.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import scipy.fft
from scipy import ndimage, signal
from scipy.interpolate import CubicSpline

from etendue.transfer import sampling
from etendue_camera.optics import diffraction
from etendue_camera.resolution import restoration_gain
from etendue_camera.resolution.edges.slanted_edge import slanted_edge
from etendue_camera.restoration import deconvolution, denoise, sharpening

FILE = Path(__file__).parent.parent / "tests" / "data" / "physics_reference.json"
PIXELS, FINER, PITCH, WAVELENGTH, F_NUMBER = 160, 6, 4.0, 0.55, 4.0
INNER = np.s_[8:-8, 8:-8]
WELLS = (16000.0, 2000.0, 300.0)
READ = 5.0  # electrons


def system(fy: Any, fx: Any) -> Any:
    """Transfer function of the camera, cycles/pixel."""
    f = np.hypot(fy, fx) / PITCH
    return (
        diffraction.circular_otf(f, WAVELENGTH, F_NUMBER)
        * np.sinc(0.86 * fy)
        * np.sinc(0.86 * fx)
        * np.exp(-2 * (1.2 * np.pi * f) ** 2)
    )


def seen(scene: Any, finer: int) -> tuple[Any, Any]:
    """What the camera gives of a scene drawn finer than its pixels, without noise; and the truth at its pixels."""
    fy, fx = scipy.fft.fftfreq(scene.shape[0], 1 / finer)[:, None], scipy.fft.rfftfreq(scene.shape[1], 1 / finer)
    spectrum = scipy.fft.rfft2(scene)
    gains = (system(fy, fx), (np.abs(fy) < 0.5) & (np.abs(fx) < 0.5))
    blurred, truth = (scipy.fft.irfft2(spectrum * gain, s=scene.shape)[::finer, ::finer] for gain in gains)
    return blurred, truth


def discs_and_edge() -> Any:
    rng, size = np.random.default_rng(5), PIXELS * FINER
    y, x = np.mgrid[:size, :size] / FINER
    scene = np.full((size, size), 0.25)
    for _ in range(1400):
        radius = 1 / math.sqrt(rng.uniform(1 / 30**2, 1 / 0.8**2))
        cy, cx = rng.uniform(0, PIXELS, 2)
        part = tuple(slice(max(int((c - radius) * FINER), 0), int((c + radius) * FINER) + 1) for c in (cy, cx))
        scene[part][(y[part] - cy) ** 2 + (x[part] - cx) ** 2 < radius**2] = rng.uniform(0.03, 0.8)
    edge = x - PIXELS / 2 - (y - PIXELS / 2) * math.tan(math.radians(5))
    return np.where(y > 0.55 * PIXELS, np.where(edge > 0, 0.8, 0.1), scene)


def edge_picture(contrast: float = 0.6, angle: float = 5.0, rows: int = 120, columns: int = 160) -> Any:
    """A noise-free edge behind the camera, exact: a square wave's harmonics through the transfer function along its
    normal.
    """
    c, s, fine, period = math.cos(math.radians(angle)), math.sin(math.radians(angle)), 32, 4096
    k = np.arange(fine * period // 2 + 1)
    harmonic = np.where(k % 2 == 1, system(k / period * s, k / period * c) / (np.pi * np.maximum(k, 1)), 0.0)
    wave = CubicSpline(
        np.arange(-600 * fine, 600 * fine) / fine,
        (0.5 + np.fft.irfft(-1j * harmonic * fine * period))[np.arange(-600 * fine, 600 * fine)],
    )
    y, x = np.mgrid[:rows, :columns]
    return 0.5 + contrast * (wave((x - 0.5 * columns + 0.3) * c + (y - 0.5 * rows + 0.2) * s) - 0.5)


@dataclass(frozen=True)
class Method:
    """``run`` of a picture; its response along a line and its price in noise where it is linear (around an even
    ground).
    """

    run: Callable[[Any], Any]
    response: Callable[[Any, Any], Any] | None = None
    price: float | None = None
    steady: bool = True  # it does the same to another picture


def plane_of(shape: tuple[int, int]) -> Any:
    fy, fx = deconvolution.frequencies(*shape)
    return fy[:, None], fx[None]


def half_price(gain: Any, columns: int) -> float:
    twice = np.full(gain.shape, 2.0)
    twice[:, 0] = 1.0
    if sampling.padded_size(columns) % 2 == 0:
        twice[:, -1] = 1.0
    return restoration_gain.response_noise_gain(gain, twice)


def beside(f: Any) -> Any:
    return f - np.where(f >= 0, 1.0, -1.0)


def wiener(variance: float, contrast: float = 0.2) -> Method:
    """As the stage `wiener`: power law, folded light as noise, the mean kept."""

    def gain(fy: Any, fx: Any) -> Any:
        fy, fx = np.broadcast_arrays(fy - np.rint(fy), fx - np.rint(fx))
        power = deconvolution.signal_spectrum(fy, fx)
        ratio = variance / contrast**2 / power
        for oy, ox in ((fy, beside(fx)), (beside(fy), fx), (beside(fy), beside(fx))):
            ratio = ratio + system(oy, ox) ** 2 * deconvolution.signal_spectrum(oy, ox) / power
        ratio = np.where((fy == 0) & (fx == 0), 0.0, ratio)
        return deconvolution.limited(deconvolution.wiener_gain(system(fy, fx), ratio), 10.0)

    return Method(
        lambda p: deconvolution.apply(p, gain(*plane_of(p.shape))),
        gain,
        half_price(gain(*plane_of((PIXELS, PIXELS))), PIXELS),
    )


def lucy(iterations: int, variation: float = 0.0, shot: float = 0.0, floor: float = 0.0, start: str = "data") -> Method:
    """As the stage `richardson_lucy`; with a noise model it ends at 0.7 of it."""

    def run(p: Any) -> Any:
        residual = 0.7 * math.sqrt(shot * max(float(p.mean()), 0.0) + floor)
        return deconvolution.richardson_lucy(
            p[None], system(*plane_of(p.shape)), iterations, variation, residual, 0.0, start
        )[0][0]

    if variation or shot:
        return Method(run, steady=not shot)

    def response(fy: Any, fx: Any) -> Any:
        return deconvolution.richardson_lucy_response(system(fy - np.rint(fy), fx - np.rint(fx)), iterations, start)

    return Method(run, response, half_price(response(*plane_of((PIXELS, PIXELS))), PIXELS))


def textbook_wiener(ratio: float) -> Method:
    """conj(H) / (|H|^2 + nsr) on the frame as it is, which closes upon itself."""

    def gain(fy: Any, fx: Any) -> Any:
        transfer = system(fy - np.rint(fy), fx - np.rint(fx))
        return transfer / (transfer**2 + ratio)

    def run(p: Any) -> Any:
        fy, fx = scipy.fft.fftfreq(p.shape[0])[:, None], scipy.fft.rfftfreq(p.shape[1])
        return scipy.fft.irfft2(scipy.fft.rfft2(p) * gain(fy, fx), s=p.shape)

    return Method(run, gain, half_price(gain(*plane_of((PIXELS, PIXELS))), PIXELS))


def textbook_lucy(iterations: int) -> Method:
    """x *= h * (y / (h * x)) with a sampled kernel, zeros beyond the border, starting at 1/2."""
    f = scipy.fft.fftfreq(33)
    kernel = np.fft.fftshift(np.fft.ifft2(system(f[:, None], f)).real)

    def run(p: Any) -> Any:
        estimate = np.full_like(p, 0.5)
        for _ in range(iterations):
            model = signal.fftconvolve(estimate, kernel, mode="same") + 1e-12
            estimate = estimate * signal.fftconvolve(p / model, kernel, mode="same")
        return estimate

    return Method(run)


def methods(shot: float, floor: float) -> dict[str, Method]:
    variance = shot + floor
    found = {"none": Method(lambda p: p, lambda fy, fx: np.ones(np.broadcast(fy, fx).shape), 1.0)}
    for k in (0.05, 0.15):
        found[f"sharpen, k = {k}"] = Method(
            lambda p, k=k: sharpening.sharpen(p, k),
            lambda fy, fx, k=k: sharpening.sharpen_response(fy, fx, k),
            sharpening.noise_gain(k),
        )
    found["unsharp, 0.7 pixel, 0.8"] = Method(
        lambda p: sharpening.unsharp(p, 0.7, 0.8),
        lambda fy, fx: sharpening.unsharp_response(fy, fx, 0.7, 0.8),
        sharpening.unsharp_noise_gain(0.7, 0.8),
    )
    found["wiener"] = wiener(variance)
    found["richardson_lucy, 10"] = lucy(10)
    found["  until the noise"] = lucy(10, 0.0, shot, floor)
    found["  until the noise, from the mean"] = lucy(10, 0.0, shot, floor, "mean")
    found["  total variation 0.002"] = lucy(10, 0.002)
    found["denoise"] = Method(lambda p: denoise.denoise(p, shot, floor, 1))
    found["denoise, then wiener"] = Method(lambda p: wiener(variance).run(denoise.denoise(p, shot, floor, 1)))
    found["peer: 1/(H^2 + nsr), nsr of white"] = textbook_wiener(variance / 0.2**2)
    found["peer: Richardson-Lucy by fftconvolve, 10"] = textbook_lucy(10)
    found["peer: scipy.signal.wiener 3 x 3"] = Method(lambda p: signal.wiener(p, 3, shot * p.mean() + floor))
    return found


def mtf50_gains(method: Method, edge: Any) -> tuple[float, float]:
    """Predicted along the normal of the edge, and measured on it."""
    c, s = math.cos(math.radians(5)), math.sin(math.radians(5))
    predicted = math.nan
    if method.response is not None:
        predicted = restoration_gain.mtf50_gain(lambda f: system(f * s, f * c), lambda f: method.response(f * s, f * c))
    return predicted, slanted_edge(method.run(edge)[10:-10, 10:-10]).mtf50 / slanted_edge(edge[10:-10, 10:-10]).mtf50


def cpu(call: Callable[[], Any], repeats: int = 5) -> float:
    best = math.inf
    for _ in range(repeats):
        began = time.thread_time()
        call()
        best = min(best, time.thread_time() - began)
    return best


def rms(found: Any, truth: Any) -> float:
    return float(np.sqrt(np.mean((found - truth)[INNER] ** 2)))


def scenes(folder: str | None) -> list[tuple[Any, Any]]:
    if folder is None:
        return [seen(discs_and_edge(), FINER)]
    from PIL import Image

    found = []
    for path in sorted(p for p in Path(folder).rglob("*") if p.suffix.lower() in (".png", ".tif", ".tiff", ".jpg")):
        grey = np.asarray(Image.open(path).convert("L"), dtype=float) / 255
        rows, columns = (size // 4 * 4 for size in grey.shape)
        found.append(seen(grey[:rows, :columns] ** 2.2 * 0.9, 4))
    return found


def table(pictures: list[tuple[Any, Any]]) -> list[tuple[str, float, float]]:
    """Prints error, figures and time by method and noise; gives (what, predicted, measured) of every prediction."""
    checked, edge, faint = [], edge_picture(), edge_picture(0.004)
    flat = np.random.default_rng(2).standard_normal((PIXELS, PIXELS))
    for well in WELLS:
        shot, floor = 1 / well, (READ / well) ** 2
        print(f"\nfull well {well:g} electrons: SNR {1 / math.sqrt(shot + floor):.0f} at clipping")
        print(f"{'':42}{'rms error':>10}{'MTF50 gain':>12}{'measured':>10}{'noise gain':>12}{'measured':>10}{'ms':>8}")
        noisy = []
        for number, (blurred, _) in enumerate(pictures):
            noise = np.random.default_rng([int(well), number]).standard_normal(blurred.shape)
            noisy.append(blurred + noise * np.sqrt(shot * np.maximum(blurred, 0) + floor))
        for name, method in methods(shot, floor).items():
            error = np.mean([rms(method.run(p), truth) for p, (_, truth) in zip(noisy, pictures, strict=True)])
            gain, measured = mtf50_gains(method, edge) if method.steady else (math.nan, math.nan)
            size = 1e-4 if "lucy" in name else 1e-3 * math.sqrt(floor + 0.4 * shot) / math.sqrt(shot)
            if method.price is None:  # not linear: at the noise of a grey field
                size = math.sqrt(shot * 0.4 + floor)
            price = float((method.run(0.4 + size * flat) - 0.4)[INNER].std() / (size * flat)[INNER].std())
            seconds = cpu(lambda m=method, p=noisy[0]: m.run(p))
            print(
                f"{name:42}{error:10.4f}{gain:12.3f}{measured:10.3f}{method.price or math.nan:12.3f}{price:10.3f}"
                f"{1e3 * seconds:8.1f}"
            )
            if method.price is not None and not name.startswith("peer"):
                small = mtf50_gains(method, faint)[1] if "lucy" in name else measured  # what its figures are about
                checked.append((f"MTF50 gain of {name}, {well:g} e", gain, small))
                checked.append((f"noise gain of {name}, {well:g} e", method.price, price))
    return checked


def against_time() -> None:
    blurred, truth = seen(discs_and_edge(), FINER)
    noisy = blurred + np.random.default_rng(1).standard_normal(blurred.shape) * np.sqrt(
        np.maximum(blurred, 0) / 16000 + (READ / 16000) ** 2
    )
    print("\nRichardson-Lucy, 16000 electrons, error against run time: iterations | rms error (peer) | ms (peer)")
    for n in (1, 2, 5, 10, 20, 50):
        own, peer = lucy(n), textbook_lucy(n)
        errors = rms(own.run(noisy), truth), rms(peer.run(noisy), truth)
        times = (1e3 * cpu(lambda m=own: m.run(noisy), 2), 1e3 * cpu(lambda m=peer: m.run(noisy), 2))
        print(f"{n:4d}   {errors[0]:.4f} ({errors[1]:.4f})   {times[0]:7.1f} ({times[1]:7.1f})")
    print("\none plane of 1024 x 1024 in single precision, ms: this | peer")
    plane = np.random.default_rng(0).uniform(0, 1, (1024, 1024)).astype(np.float32)
    taps = (np.pad([[1.0]], 1) + 0.15 * sharpening.LAPLACIAN).astype(np.float32)
    gain = wiener(1e-4).response(*plane_of(plane.shape))
    pairs = {
        "sharpen | ndimage.convolve": (lambda: sharpening.sharpen(plane, 0.15), lambda: ndimage.convolve(plane, taps)),
        "unsharp | ndimage.gaussian_filter": (
            lambda: sharpening.unsharp(plane, 0.7, 0.8),
            lambda: ndimage.gaussian_filter(plane, 0.7),
        ),
        "wiener, gain at hand | float64 fft2": (
            lambda: deconvolution.apply(plane, gain),
            lambda: np.fft.ifft2(np.fft.fft2(plane.astype(float)) * 0.5).real,
        ),
        "denoise | scipy.signal.wiener": (
            lambda: denoise.denoise(plane, 1e-4, 1e-6, 1),
            lambda: signal.wiener(plane, 3, 1e-4),
        ),
    }
    for name, (own, peer) in pairs.items():
        print(f"{name:42}{1e3 * cpu(own, 3):8.1f} {1e3 * cpu(peer, 3):8.1f}")


def references() -> list[tuple[str, float, float, str]]:
    """Largest error of both groups of high-precision cases, and what the textbook's lines make of them."""
    document = json.loads(FILE.read_text())
    cases = next(g["cases"] for g in document["groups"] if g["name"] == "wiener_gain")
    worst, peer = 0.0, 0.0
    for case in cases:
        h, nsr = complex(float(case["in"]["H_re"]), float(case["in"]["H_im"])), float(case["in"]["nsr"])
        true = complex(*map(float, case["out"]))
        with np.errstate(all="ignore"):
            both = (
                complex(deconvolution.wiener_gain(np.array(h), nsr)),
                complex(np.conj(h) / np.float64(abs(h) ** 2 + nsr)),
            )
        own, usual = (abs(g - true) / max(abs(true), 1e-300) for g in both)
        worst, peer = max(worst, own), max(peer, usual) if math.isfinite(usual) else math.inf
    found = [("wiener_gain, relative", 1e-14, worst, f"{peer:.2g}")]
    worst = peer = 0.0
    for case in document["extra"]["richardson_lucy_1d"]:
        data, kernel = (np.array([case[name]], dtype=float) for name in ("y", "h"))
        transfer, true = scipy.fft.rfft2(kernel / kernel.sum()), np.array([float(v) for v in case["out"]])
        got, _ = deconvolution.richardson_lucy_periodic(data, transfer, case["iterations"])
        worst = max(worst, float(np.abs(got[0] - true).max()))
        estimate = np.full_like(data, data.mean())
        with np.errstate(all="ignore"):
            for _ in range(case["iterations"]):
                ratio = data / scipy.fft.irfft2(scipy.fft.rfft2(estimate) * transfer, s=data.shape)
                estimate = estimate * scipy.fft.irfft2(scipy.fft.rfft2(ratio) * np.conj(transfer), s=data.shape)
        apart = float(np.abs(estimate[0] - true).max())
        peer = max(peer, apart) if math.isfinite(apart) else math.inf
    return [*found, ("richardson_lucy_1d, absolute", 1e-13, worst, f"{peer:.2g}")]


def kept() -> list[tuple[str, float, float, str]]:
    """What deconvolution and denoising keep, and their single precision."""
    p = np.random.default_rng(7).uniform(0, 1, (97, 130))
    whole = sampling.pad(p)
    transfer = system(*plane_of(p.shape))
    estimate, _ = deconvolution.richardson_lucy_periodic(whole, transfer, 20)
    quiet = denoise.denoise(p, 1e-3, 1e-4, 2)
    gain, grey = wiener(1e-4).response(*plane_of(p.shape)), np.full(p.shape, 0.3)
    single = deconvolution.apply(p.astype(np.float32), gain)
    few = [deconvolution.richardson_lucy(p.astype(kind)[None], transfer, 10)[0] for kind in (np.float32, np.float64)]
    return [
        ("sum kept by richardson_lucy, relative", 1e-12, abs(estimate.sum() / whole.sum() - 1), ""),
        (
            "mean moved by denoise",
            1e-14,
            abs(quiet.mean() - p.mean()),
            f"{abs(signal.wiener(p, 5, 0.01).mean() - p.mean()):.2g}",
        ),
        ("constant moved by wiener", 1e-14, float(np.abs(deconvolution.apply(grey, gain) - 0.3).max()), ""),
        ("wiener in float32", 5e-6, float(np.abs(single - deconvolution.apply(p, gain)).max()), ""),
        ("richardson_lucy, 10, in float32", 2e-5, float(np.abs(few[0] - few[1]).max()), ""),
    ]


def main() -> int:
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--pictures", metavar="FOLDER", help="photographs instead of the drawn scene")
    folder = arguments.parse_args().pictures
    if folder is None:
        print("photographs are skipped: give --pictures FOLDER")
    checked = table(scenes(folder))
    against_time()
    claims = [*references(), *kept()]
    for what, bound in (("MTF50 gain", 0.02), ("noise gain", 0.02)):
        apart = [(abs(m / p - 1), name) for name, p, m in checked if name.startswith(what) and math.isfinite(p)]
        worst, name = max(apart)
        claims.append((f"{what}, predicted against measured ({name.split(' of ')[1]})", bound, worst, ""))
    print(f"\n{'':78}{'bound':>9}{'measured':>11}{'peer':>9}")
    broken = 0
    for name, bound, measured, peer in claims:
        broken += not measured <= bound
        print(f"{name:78}{bound:9.0e}{measured:11.2e}{peer:>9}   {'holds' if measured <= bound else 'BROKEN'}")
    return 1 if broken else 0


if __name__ == "__main__":
    sys.exit(main())
