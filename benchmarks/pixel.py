"""The pixel against its bounds: diffusion over the whole box, contrast at every sampling, charge behind the filters.

    python benchmarks/pixel.py

Prints bound | measured, and error against run time of the knobs ``diffusion.nodes`` and ``crosstalk.beyond``. The
reference of the diffusion transfer function is 40-digit arithmetic where mpmath is installed, else the same integral
over depth in the widest floats of the machine.
"""

from __future__ import annotations

import math
import time

import numpy as np

from etendue.transfer import sampling
from etendue_camera.sensor import cfa, crosstalk, photodiode, silicon
from etendue_camera.sensor.stages.crosstalk import channel_kernels, tables_of
from etendue_camera.sensor.stages.pixel import Diffusion, Pixel
from etendue_camera.sensor.stages.sensitivity import electrons_per_irradiance

RANDOM = np.random.default_rng(2010)
POINTS = 3000


def row(claim: str, bound: str, measured: str, held: bool | None = None) -> None:
    print(f"{claim:<78} | {bound:>12} | {measured:>22} | {'' if held is None else 'held' if held else 'MISSED'}")


def best_of(repeat: int, call) -> float:  # type: ignore[no-untyped-def]
    """Shortest CPU time of this thread, seconds."""
    found = []
    for _ in range(repeat):
        start = time.thread_time()
        call()
        found.append(time.thread_time() - start)
    return min(found)


# -- diffusion over the box of the research notes


def reference():  # type: ignore[no-untyped-def]
    """D(f) at full accuracy: (function, its name)."""
    try:
        import mpmath as mp
    except ImportError:
        nodes = [np.array(v, np.longdouble) for v in np.polynomial.legendre.leggauss(60)]

        def quadrature(f: float, alpha: float, depletion: float, depth: float, length: float, back: str) -> float:
            a, x = (
                np.longdouble(alpha) * depth,
                np.longdouble(depth) * np.hypot(1 / np.longdouble(length), 2 * np.pi * np.longdouble(f)),
            )
            edges = min(np.longdouble(1), 60 / (a + x)) * np.array(
                [0, 0.02, 0.06, 0.12, 0.25, 0.5, 0.75, 1], np.longdouble
            )
            half = np.diff(edges)[:, None] / 2
            y = edges[:-1, None] + half * (1 + nodes[0])
            if back == "absorbing":
                chance = np.exp(-x * y) * np.expm1(-2 * x * (1 - y)) / np.expm1(-2 * x)
            else:
                chance = np.exp(-x * y) * (1 + np.exp(-2 * x * (1 - y))) / (1 + np.exp(-2 * x))
            passed = np.exp(-np.longdouble(alpha) * depletion)
            return -np.expm1(-np.longdouble(alpha) * depletion) + passed * a * np.sum(
                half * nodes[1] * np.exp(-a * y) * chance
            )

        return quadrature, "quadrature, long double"
    mp.mp.dps = 60

    def exact(f: float, alpha: float, depletion: float, depth: float, length: float, back: str):  # type: ignore[no-untyped-def]
        a, ld, d, ln = (mp.mpf(float(v)) for v in (alpha, depletion, depth, length))
        k = mp.sqrt(1 / ln**2 + (2 * mp.pi * mp.mpf(float(f))) ** 2)
        # integral of exp(-a z) g(z) over the depth, in exponentials
        if back == "absorbing":
            up, down = 1 / (1 - mp.exp(-2 * k * d)), -mp.exp(-2 * k * d) / (1 - mp.exp(-2 * k * d))
        else:
            up, down = 1 / (1 + mp.exp(-2 * k * d)), mp.exp(-2 * k * d) / (1 + mp.exp(-2 * k * d))
        rising = d if a == k else (1 - mp.exp(-(a - k) * d)) / (a - k)
        below = up * (1 - mp.exp(-(a + k) * d)) / (a + k) + down * rising
        return 1 - mp.exp(-a * ld) + mp.exp(-a * ld) * a * below

    return exact, "mpmath, 60 digits"


def diffusion() -> None:
    exact, name = reference()
    print(f"\nDiffusion transfer function D(f)/D(0), {POINTS} random photodiodes; reference: {name}\n")
    worst = {np.float64: 0.0, np.float32: 0.0}
    outside = rising = 0
    for number in range(POINTS):
        back = ("absorbing", "reflecting")[number % 2]
        alpha, depletion, depth, length, f = (
            10.0 ** RANDOM.uniform(*r) for r in ((-6, 3), (-3, 2), (-2, 3), (-1, 5), (-5, 3))
        )
        if number % 10 == 0:  # beside the removable singularity alpha L_f = 1
            f = math.sqrt(max(alpha**2 - length**-2, 1e-12)) / (2 * math.pi) * (1 + RANDOM.uniform(-1e-6, 1e-6))
        for kind in worst:
            at = kind(f)
            true = float(
                exact(at, alpha, depletion, depth, length, back) / exact(0.0, alpha, depletion, depth, length, back)
            )
            found = photodiode.collection_mtf(at, alpha, depletion, depth, length, back)  # type: ignore[arg-type]
            worst[kind] = max(worst[kind], abs(float(found) / true - 1))
        line = photodiode.collection_mtf(
            np.concatenate([[0.0], np.geomspace(1e-5, 1e3, 200)]), alpha, depletion, depth, length, back
        )  # type: ignore[arg-type]
        outside += int((line < 0).sum() + (line > 1).sum())
        rising += int((np.diff(line) > 1e-14 * line[:-1]).sum())
    row("relative error, float64", "2e-14", f"{worst[np.float64]:.1e}", worst[np.float64] <= 2e-14)
    row("relative error, float32", "1e-6", f"{worst[np.float32]:.1e}", worst[np.float32] <= 1e-6)
    row("values below 0 or above 1, of 201 frequencies each", "0", str(outside), outside == 0)
    row("rises with the frequency by more than rounding", "0", str(rising), rising == 0)
    limits = [
        photodiode.collection_mtf(0.1, 0.0, 1.8, 10.0, 50.0)
        - (reach(0.1, 1.8, 10.0, 50.0) / reach(0.0, 1.8, 10.0, 50.0)),
        photodiode.collection_mtf(0.1, 0.6, 1.8, np.inf, np.inf) - (1 - math.exp(-1.08) / (1 + 0.6 / (0.2 * math.pi))),
        photodiode.collection_mtf(0.1, 0.6, np.inf, 10.0, 50.0) - 1.0,
    ]
    row(
        "alpha = 0, endless silicon and life, endless depletion: error",
        "2e-14",
        f"{np.abs(limits).max():.1e}",
        np.abs(limits).max() <= 2e-14,
    )


def reach(f: float, depletion: float, depth: float, length: float) -> float:
    """D/alpha as alpha vanishes."""
    k = math.hypot(1 / length, 2 * math.pi * f)
    return depletion + math.tanh(0.5 * k * depth) / k


def table() -> None:
    print(
        "\nDiffusion on a frame of 512 x 512 x 31 bands (padded 640 x 640), error against nodes = 0, 0.40 to 0.70 um\n"
    )
    fy, fx = sampling.frequencies(512, 1.0, half=False)[:, None], sampling.frequencies(512, 1.0, half=True)[None, :]
    wavelength = np.linspace(0.40, 0.70, 31)[:, None, None]
    exact = Diffusion(nodes=0).transfer(fy, fx, wavelength)
    print(f"{'nodes':>8} {'largest error':>14} {'stated':>10} {'CPU ms':>8}")
    for nodes in (256, 512, 1024, 2048, 4096, 0):
        stage = Diffusion(nodes=nodes)
        apart = float(np.abs(stage.transfer(fy, fx, wavelength) - exact).max())
        seconds = best_of(5, lambda: stage.transfer(fy, fx, wavelength))  # noqa: B023
        print(f"{nodes:>8} {apart:>14.1e} {stage.error({}, {}, 'float64')[0]:>10.1e} {1e3 * seconds:>8.0f}")
        if nodes == 4096:
            found = (apart, seconds)
    print()
    row("transfer function of 512 x 512 x 31, default nodes: error", "1e-12", f"{found[0]:.1e}", found[0] <= 1e-12)
    row("the same: CPU, one thread", "60 ms", f"{1e3 * found[1]:.0f} ms", found[1] <= 0.06)


# -- contrast behind the pixel at every sampling


def contrast(samples: float, cycles: float, diffuse: bool, pixels: int = 400, pitch: float = 2.0) -> float:
    """Contrast left of a sine with that many samples per pixel, fitted in the middle of the frame."""
    step, f = pitch / samples, cycles / pitch
    size = round(pixels * samples)
    x = step * (np.arange(size) - 0.5 * (size - 1))
    light = np.broadcast_to(1 + 0.5 * np.cos(2 * np.pi * f * x + 0.3), (16, size))[None]
    fy, fx = sampling.frequencies(16, step, half=False)[:, None], sampling.frequencies(size, step, half=True)[None, :]
    half = sampling.transform(light) * Pixel(peak_qe=(0.5,), pixel_pitch=pitch, aperture_fraction=1.0).transfer(
        fy, fx, None, None
    )
    if diffuse:
        half = half * Diffusion().transfer(fy, fx, np.array([[[0.6]]]))
    count = pixels - 8
    first = (0.5 * (size - 1) * step - 0.5 * (count - 1) * pitch) / step
    seen = sampling.sample(half, 16, size, (8, 1, 1), (first, samples, count))[0, 0]
    centre = pitch * (np.arange(count) - 0.5 * (count - 1))
    middle = np.abs(centre) < 0.25 * pixels * pitch
    waves = np.stack([np.ones(count), np.cos(2 * np.pi * f * centre), np.sin(2 * np.pi * f * centre)], axis=1)[middle]
    mean, even, odd = np.linalg.lstsq(waves, seen[middle], rcond=None)[0]
    return math.hypot(even, odd) / (0.5 * mean)


def every_sampling() -> None:
    print("\nContrast of a sine behind a pixel with a window as wide as its pitch, by samples per pixel\n")
    alpha = float(silicon.absorption(0.6))
    names = ("2", "2.5", "3", "pi", "4", "5", "8")
    ratios = (2, 2.5, 3, math.pi, 4, 5, 8)
    print(f"{'cycles/pixel':>24} {'true':>8} " + " ".join(f"{n:>8}" for n in names))
    worst = 0.0
    for cycles in (0.1, 0.25, 0.45):
        for diffuse in (False, True):
            true = float(np.sinc(cycles))
            if diffuse:
                true *= float(photodiode.collection_mtf(cycles / 2.0, alpha, 1.8, 10.0, 50.0))
            found = [contrast(s, cycles, diffuse) for s in ratios]
            worst = max(worst, *(abs(c - true) for c in found))
            label = f"{cycles} {'x diffusion' if diffuse else ''}"
            print(f"{label:>24} {true:>8.5f} " + " ".join(f"{c:>8.5f}" for c in found))
    print()
    row("contrast against sinc x diffusion, every sampling from 2 per pixel", "1e-3", f"{worst:.1e}", worst <= 1e-3)


# -- charge behind the filters


def behind_filters() -> None:
    print(
        "\nCrosstalk through the filters: share of the charge that leaves its pixel, 650 nm, depletion 1.8, depth 10, "
        "length 50 um\n"
    )
    alpha = float(silicon.absorption(0.65))
    t = crosstalk.times(10.0, 50.0)
    kept, moved = crosstalk.shares(t, alpha, 1.8, 10.0, 50.0)
    print(f"{'pitch um':>10} {'lit whole':>10} {'window 0.741':>13} {'contract':>9}")
    apart = 0.0
    for pitch, contract in ((1.1, 0.42), (2.8, 0.33), (5.4, 0.25)):
        left = []
        for light in (1.0, 0.741):
            along = crosstalk.pixel_shares(t, light * pitch, pitch, 60)
            left.append(1 - float(crosstalk.kernels(np.array([kept]), moved[None], along, along)[0].max()))
        apart = max(apart, abs(left[0] - contract))
        print(f"{pitch:>10} {left[0]:>10.4f} {left[1]:>13.4f} {contract:>9}")
    print()
    row("lit over the whole pixel, against the contract's two digits", "0.005", f"{apart:.4f}", apart <= 0.005)
    mask, edges = cfa.parse("RGGB"), tuple(np.arange(380.0, 781.0, 10.0))
    stage = Pixel(peak_qe=(0.36, 0.44, 0.40), pixel_pitch=1.1, crosstalk="through_filter")
    photons, tables = electrons_per_irradiance(stage, edges), tables_of(stage, edges)
    kernels = channel_kernels(photons, tables, 1e-8)
    r = kernels.shape[1] // 2
    mosaic = np.zeros((8 * r, 8 * r))
    mosaic[2 * r : 6 * r : 2, 2 * r : 6 * r : 2] = RANDOM.uniform(0.5, 1.0, (2 * r, 2 * r))
    spread = crosstalk.diffuse(mosaic, kernels, mask)
    lost = abs(spread.sum() / mosaic.sum() - 1)
    row("light through red filters only: charge lost or made", "1e-12", f"{lost:.1e}", lost <= 1e-12)
    index = cfa.channel_index(mask, *mosaic.shape)
    down, right = np.mgrid[-r : r + 1, -r : r + 1]
    places = ((down % 2 == 0) & (right % 2 == 0), (down + right) % 2 == 1, (down % 2 == 1) & (right % 2 == 1))
    found = [spread[index == c].sum() / mosaic.sum() for c in range(3)]
    apart = max(abs(f - kernels[0][p].sum()) for f, p in zip(found, places, strict=True))
    row(
        f"found in red {found[0]:.4f}, green {found[1]:.4f}, blue {found[2]:.4f}: against the kernel",
        "1e-12",
        f"{apart:.1e}",
        apart <= 1e-12,
    )
    row(
        "kernels: smallest value; sum - 1",
        "0; 1e-14",
        f"{kernels.min():.1e}; {abs(kernels.sum((1, 2)) - 1).max():.1e}",
        kernels.min() >= 0,
    )
    print(f"\n{'beyond':>8} {'kernel':>8} {'largest error':>14} {'CPU ms':>8}   mosaic of 1024 x 1024, RGGB, 1.1 um")
    noise = RANDOM.uniform(0.0, 1.0, (1024, 1024))
    reference = crosstalk.diffuse(noise, channel_kernels(photons, tables, 1e-14), mask)
    for beyond in (1e-2, 1e-4, 1e-6, 1e-8, 1e-12):
        kernels = channel_kernels(photons, tables, beyond)
        error = float(np.abs(crosstalk.diffuse(noise, kernels, mask) - reference).max() / reference.max())
        seconds = best_of(2, lambda: crosstalk.diffuse(noise, kernels, mask))  # noqa: B023
        print(f"{beyond:>8.0e} {kernels.shape[1]:>8} {error:>14.1e} {1e3 * seconds:>8.0f}")


def a_frame() -> None:
    """A whole frame of frequencies takes less than a blink, however deep the silicon."""
    frame = np.hypot(np.fft.fftfreq(500)[:, None], np.fft.rfftfreq(598)[None, :])
    for depth in (1.0, 10.0, 500.0):
        seconds = best_of(5, lambda depth=depth: photodiode.collection_mtf(frame, 0.639, 1.8, depth, 50.0))
        row(
            f"diffusion transfer of 500 x 300 frequencies, {depth:g} um deep",
            "60 ms",
            f"{1e3 * seconds:.1f} ms",
            seconds < 0.06,
        )


def main() -> None:
    print(f"{'claim':<78} | {'bound':>12} | {'measured':>22} |")
    diffusion()
    table()
    every_sampling()
    behind_filters()
    a_frame()


if __name__ == "__main__":
    main()
