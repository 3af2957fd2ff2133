"""Field-dependent blur and distortion: error against run time, what ``auto`` chooses, and the claims.

    python benchmarks/field_blur.py [--quick]

Lenses: 0.05, 0.15 and 0.5 waves each of coma, astigmatism and field curvature at the corner (f/4, 550 nm), pictures of
65 x 65 samples of 0.5 um at 9 heights; a window of 512 x 512 samples from corner to corner. Errors of a random scene
(0.9 black, 0.1 light points, the hardest kind) and of edges, as rms over mean as usual for such tables and as the
largest error over full scale, beside the bound that was predicted; against the finest tiles that fit. Times: one plane
of float32, one thread, CPU.
"""

from __future__ import annotations

import sys
import time
from typing import Any

import numpy as np
from scipy.special import erf
from threadpoolctl import threadpool_limits

from etendue_camera.field import blur, warp
from etendue_camera.field.psf_bank import PsfBank

N_LENS, WAVELENGTH, SIZE, PITCH = 4.0, 0.55, 65, 0.5
HEIGHTS = np.linspace(0.0, 1.0, 9)
LOST = 2e-3  # of the flux, in tails that all kernels cut off alike
LENSES = {"weak": 0.05, "moderate": 0.15, "strong": 0.5}


def picture(height: float, waves: float) -> Any:
    """Picture of a point from a pupil with coma, astigmatism and field curvature; height relative to the corner."""
    total = 4 * SIZE
    frequency = np.fft.fftfreq(total, PITCH) * 2 * WAVELENGTH * N_LENS
    y, x = frequency[:, None], frequency[None, :]
    r = np.hypot(y, x)
    edge = 2 * WAVELENGTH * N_LENS / total / PITCH
    inside = np.clip((1 - r) / edge + 0.5, 0, 1)
    phase = waves * (height * y * r**2 + height**2 * y**2 + height**2 * r**2)
    psf = np.abs(np.fft.fftshift(np.fft.fft2(inside * np.exp(2j * np.pi * phase)))) ** 2
    low = total // 2 - SIZE // 2
    return psf[low : low + SIZE, low : low + SIZE]


def bank(waves: float, corner: float) -> PsfBank:
    return PsfBank(HEIGHTS * corner, [WAVELENGTH], [[picture(h, waves)] for h in HEIGHTS], PITCH)


def clock(call: Any) -> tuple[float, Any]:
    best, found = np.inf, None
    for _ in range(2):
        start = time.thread_time()
        found = call()
        best = min(best, time.thread_time() - start)
    return best, found


def blurs(n: int) -> None:
    line = (np.arange(n) - 0.5 * (n - 1)) * PITCH
    rng = np.random.default_rng(0)
    points = (rng.random((1, n, n)) < 0.1).astype(np.float32)
    step = 40 * PITCH
    tilted = np.sin(2 * np.pi * (line[None, :] + 0.2 * line[:, None]) / step) / 0.12
    edges = (0.5 + 0.5 * erf(tilted))[None].astype(np.float32)
    for name, waves in LENSES.items():
        pictures = bank(waves, float(np.hypot(line[0], line[0])))
        reference = blur.prepare(pictures, line, line, [WAVELENGTH], "tiles", 1e-3, 65, lost=LOST)
        exact = [blur.apply(scene.astype(float), reference) for scene in (points, edges)]
        print(
            f"\n{name}: {waves:g} waves, kernels of {reference.choice.size} samples; reference {reference.choice.grid} "
            f"tiles,",
            end=" ",
        )
        print(f"bound {reference.choice.error - LOST:.1e} from the direct sum")
        print(
            f"{'method':<14}{'count':>6}{'ms':>8}{'rms/mean':>11}{'largest, points':>17}{'edges':>10}{'bound':>10}"
            f"{'cost':>7}"
        )

        def row(label: str, prepared: Any, exact: Any = exact) -> float:
            seconds, image = clock(lambda: blur.apply(points, prepared))
            apart = [np.abs(a - b) for a, b in zip((image, blur.apply(edges, prepared)), exact, strict=True)]
            rms = float(np.sqrt(np.mean(apart[0] ** 2)) / points.mean())
            choice = prepared.choice
            print(
                f"{label:<14}{choice.count:>6}{seconds * 1e3:>8.0f}{rms:>11.1e}{apart[0].max():>17.1e}"
                f"{apart[1].max():>10.1e}"
                f"{choice.error - LOST:>10.1e}{choice.cost:>7.0f}"
            )
            return float(max(a.max() for a in apart))

        for method, counts in (("tiles", (5, 9, 17, 33)), ("eigen", (3, 6, 12, 24, 48))):
            for count in counts:
                row(method, blur.prepare(pictures, line, line, [WAVELENGTH], method, 1e-2, count, lost=LOST))  # type: ignore[arg-type]
        for tolerance in (3e-2, 1e-2, 3e-3):
            try:
                start = time.thread_time()
                prepared = blur.prepare(pictures, line, line, [WAVELENGTH], "auto", tolerance, lost=LOST)
                made = time.thread_time() - start
            except ValueError as error:
                print(f"auto {tolerance:g}: {error}")
                continue
            ((other, count, _, cost),) = prepared.choice.others
            worst = row(f"auto {tolerance:g}", prepared)
            said = "held" if worst <= tolerance else "BROKEN"
            if prepared.choice.grid == reference.choice.grid:
                said = "not tested here, the reference has the same grid"
            print(
                f"    -> {prepared.choice.method}, nodes {prepared.choice.grid}, made in {made:.1f} s; "
                f"{other} would take {count}, cost {cost:.0f};"
                f"\n       largest error <= {tolerance:g}: {said} ({worst:.1e})"
            )


def claims(n: int) -> None:
    line = (np.arange(n) - 0.5 * (n - 1)) * PITCH
    pictures = bank(0.5, float(np.hypot(line[0], line[0])))
    print("\nclaim                                                   bound   measured")
    rng = np.random.default_rng(1)
    for kind, bound in ((np.float32, 1e-6), (np.float64, 1e-6)):
        for method in ("tiles", "eigen"):
            prepared = blur.prepare(pictures, line, line, [WAVELENGTH], method, 1e-2, 9)  # type: ignore[arg-type]
            reach, worst = prepared.choice.size // 2 + 1, 0.0
            for place in rng.integers(reach, n - reach, (16, 2)):
                plane = np.zeros((1, n, n), dtype=kind)
                plane[(0, *place)] = 1.0
                worst = max(worst, abs(float(blur.apply(plane, prepared).sum(dtype=float)) - 1))
            print(f"flux of a point, {method}, {np.dtype(kind).name:<8}, 16 places{'':<18}{bound:>8.0e} {worst:>10.1e}")
    kernels = [pictures.kernel_at(*place, PITCH)[0] for place in rng.uniform(line[0], line[-1], (50, 2))]
    print(
        f"flux of a kernel, 50 places and azimuths{'':<15}{1e-6:>8.0e} {max(abs(k.sum() - 1) for k in kernels):>10.1e}"
    )
    prepared = blur.prepare(pictures, line, line, [WAVELENGTH], "tiles", 1e-2, 9, weights="image")
    worst = float(np.abs(blur.apply(np.ones((1, n, n), np.float32), prepared) - 1).max())
    print(f"a uniform plane, weights 'image', float32{'':<14}{1e-6:>8.0e} {worst:>10.1e}")
    print(
        f"a uniform plane, weights 'source': divergence of the mean displacement {blur.unevenness(pictures):.1e} (not "
        f"bounded)"
    )


def distortion(n: int) -> None:
    line = np.arange(n) - 0.5 * (n - 1)
    corner = float(np.hypot(line[0], line[0]))
    lens = warp.DistortionCurve((-0.0648, 0.00596, -0.00047), corner / 1.02)
    ratio = lens.ratio(corner, 0.55)
    radius = np.linspace(0, 0.99 * corner * 0.93, 4001)
    back = lens.undistort(lens.distort(radius, 0.55), 0.55)
    print(
        f"\nundistort(distort(r)) = r: largest error {np.abs(back - radius).max() / corner:.1e} of the corner; bound "
        f"1e-12"
    )
    print(
        f"distortion of a small asphere (-6.2 % at the corner), {n} x {n}: largest error of slanted edges over "
        f"contrast, and bound"
    )
    print(
        f"{'order':>6}{'oversampling':>13}{'ms':>7}" + "".join(f"{f'{s:g} samples':>22}" for s in (1.0, 1.4, 2.0, 4.0))
    )

    def chart(y: Any, x: Any, softness: float) -> Any:
        return 0.5 + 0.5 * erf((x * np.cos(0.1) + y * np.sin(0.1) - 0.21 * n) / np.sqrt(2) / softness)

    square = line[:, None] ** 2 + line**2
    inside = slice(n // 8, -n // 8)
    for order, oversampling in ((1, 1), (2, 1), (3, 1), (4, 1), (5, 1), (3, 2), (5, 2)):
        cells, seconds = [], 0.0
        for softness in (1.0, 1.4, 2.0, 4.0):
            plane = chart(line[:, None], line[None, :], softness)
            seconds, moved = clock(lambda p=plane, o=order, v=oversampling: warp.radial(p, line, line, ratio, o, v))
            exact = chart(ratio(square) * line[:, None], ratio(square) * line[None, :], softness)
            found, bound = np.abs(moved - exact)[inside, inside].max(), warp.edge_error(order, softness, oversampling)
            cells.append(f"{found:>11.1e} <{bound:>8.1e}{' ' if found <= bound else '!'}")
        print(f"{order:>6}{oversampling:>13}{seconds * 1e3:>7.0f}" + "".join(f"{c:>22}" for c in cells))


if __name__ == "__main__":
    with threadpool_limits(1):
        quick = "--quick" in sys.argv
        claims(256)
        distortion(512)
        blurs(256 if quick else 512)
