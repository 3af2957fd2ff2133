"""The real lens against optiland's own analysis of it, and what the knobs cost: ``python against_optiland.py``.

Both trace the same sample lens, rays aimed at the paraxial entrance pupil, at the paper's focal length, fields and
wavelengths.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
from etendue_lens_optiland import banks, pupil
from etendue_lens_optiland.lens import open_lens
from optiland.analysis import Distortion
from optiland.psf import FFTPSF, HuygensPSF
from optiland.samples.objectives import ReverseTelephoto

FIELDS, WAVELENGTHS = (0.0, 22.0, 30.0), (0.45, 0.55, 0.65)


def sample(f_number: float) -> Any:
    optic = ReverseTelephoto()
    optic.wavelengths.wavelengths.clear()
    for wavelength in WAVELENGTHS:
        optic.wavelengths.add(value=wavelength, is_primary=wavelength == 0.55)
    optic.fields.fields.clear()
    for angle in FIELDS:
        optic.fields.add(y=angle)
    optic.updater.scale_system(6.93 / float(np.ravel(optic.paraxial.f2())[0]))
    optic.set_aperture("EPD", 6.93 / f_number)
    return optic


def seconds(what: Callable[[], Any]) -> tuple[Any, float]:
    began = time.perf_counter()
    found = what()
    return found, time.perf_counter() - began


def strehl_table() -> None:
    print("\nStrehl ratio, ours | optiland (FFT, 128 rays, 1024 grid)")
    print(f"{'f/':>5} {'field':>6}  " + "".join(f"{w * 1e3:>14.0f} nm" for w in WAVELENGTHS))
    for f_number in (2.5, 4.0, 6.7):
        optic, lens = sample(f_number), open_lens(f_number=f_number, aiming="paraxial")
        worst, own, other = 0.0, 0.0, 0.0
        for field in FIELDS:
            cells = []
            for wavelength in WAVELENGTHS:
                tangent = float(np.tan(np.radians(field)))
                mine, spent = seconds(
                    lambda t=tangent, w=wavelength, of=lens: pupil.strehl(banks.resolved(of, t, w, 128))
                )
                own += spent
                theirs, spent = seconds(
                    lambda h=field / 30, w=wavelength, of=optic: FFTPSF(of, (0, h), w, 128, 1024).strehl_ratio()
                )
                other += spent
                worst = max(worst, abs(mine - theirs))
                cells.append(f"{mine:8.4f}|{theirs:.4f}")
            print(f"{f_number:5g} {field:6g}  " + "".join(f"{cell:>17}" for cell in cells))
        print(f"{'':12}  largest difference {worst:.4f}; time {own:.2f} s | {other:.2f} s")


def axial_pictures() -> None:
    print("\nAxial picture at 550 nm, largest difference over the peak, and time, ours | optiland")
    for f_number in (2.5, 6.7):
        optic, lens = sample(f_number), open_lens(f_number=f_number, aiming="paraxial")
        theirs, other = seconds(lambda of=optic: FFTPSF(of, (0, 0), 0.55, 256, 2048))
        at = np.arange(-60, 61)
        step = 0.55 * theirs._get_working_FNO() * 255 / 2048
        psf = theirs.psf[np.ix_(1024 + at, 1024 + at)] / 100
        found, own = seconds(lambda of=lens, a=at * step: pupil.intensity(of.bundle(0.0, 0.55, 256), a, a))
        print(
            f"  f/{f_number:<4g} FFT, 121 x 121      {np.abs(found - psf).max() / psf.max():.2e}   {own:.2f} s | "
            f"{other:.2f} s"
        )
        theirs, other = seconds(lambda of=optic: HuygensPSF(of, (0, 0), 0.55, 128, 32, pixel_pitch=8e-4))
        x, y, _ = theirs._get_image_coordinates()
        found, own = seconds(
            lambda of=lens, a=1e3 * y[:, 0], b=1e3 * x[0]: pupil.intensity(of.bundle(0.0, 0.55, 128), a, b)
        )
        apart = np.abs(found / found.max() - theirs.psf / theirs.psf.max()).max()
        print(
            f"  f/{f_number:<4g} Huygens, 32 x 32    {apart:.2e}   {own:.2f} s | {other:.2f} s (each over its own peak)"
        )


def distortion() -> None:
    optic, lens = sample(4.0), open_lens(f_number=4.0, aiming="paraxial")
    tangents = np.tan(np.radians(np.linspace(1e-10, 30.0, 61)))
    theirs, other = seconds(lambda: np.ravel(Distortion(optic, wavelengths=[0.55], num_points=61).data[0]))
    found, own = seconds(
        lambda: 100 * (lens.chief(tangents[1:], 0.55)[1] / (lens.image_distance_um * tangents[1:]) - 1)
    )
    print("\nDistortion at 550 nm, per cent, ours | optiland")
    for number in (20, 44, 60):
        print(f"  {0.5 * number:4g} degrees  {found[number - 1]:.7f} | {theirs[number]:.7f}")
    print(f"  largest difference {np.abs(found - theirs[1:]).max():.1e}; time {own:.3f} s | {other:.3f} s")


def flux() -> None:
    print("\nIllumination against conservation of flux, E/L h dh = A cos(t) sin(t) dt, f/11")
    lens, step = open_lens(f_number=11.0), 1e-4
    for field in (0.5, 10.0, 22.0, 30.0):
        angle = float(np.radians(field))
        bundle = lens.bundle(float(np.tan(angle)), 0.55, 128)
        lower, upper = lens.chief(np.tan([angle - step, angle + step]), 0.55)[1]
        entering = 2 * bundle.open.sum() * lens.scale**2 * np.cos(angle) * np.sin(angle)
        print(
            f"  {field:4g} degrees  "
            f"{bundle.solid_angle * bundle.height * (upper - lower) / (2 * step) / entering - 1:+.1e}"
        )


def knobs() -> None:
    print("\nStrehl ratio at 22 degrees, 550 nm by pupil samples: error against 1024, time")
    for f_number in (2.8, 5.6):
        lens = open_lens(f_number=f_number)
        tangent = float(np.tan(np.radians(22.0)))
        true = pupil.strehl(lens.bundle(tangent, 0.55, 1024))
        for samples in (32, 64, 128, 256, 512):
            found, spent = seconds(lambda n=samples, of=lens, t=tangent: pupil.strehl(of.bundle(t, 0.55, n)))
            print(f"  f/{f_number:<4g} {samples:5d}   {abs(found - true) / true:.1e}   {spent:.2f} s")
    print("\nBanks of 3 x 3 pictures: samples, pupil, light in the window (least), time")
    for f_number in (4.0, 8.0):
        lens = open_lens(f_number=f_number)
        for lost in (0.1, 0.02):
            made, spent = seconds(
                lambda of=lens, share=lost: banks.psf_bank(of, banks.tangents_of(FIELDS), WAVELENGTHS, 128, lost=share)
            )
            size = made.bank.psf.shape[-1]
            print(
                f"  f/{f_number:<4g} lost {lost:<5g} {size:4d}  {made.samples:4d}  {made.enclosed.min():.4f}   "
                f"{spent:.2f} s"
            )


if __name__ == "__main__":
    sample(4.0).trace_generic(0.0, 0.0, 0.0, 0.0, 0.55)  # compiles what numba compiles
    HuygensPSF(sample(4.0), (0, 0), 0.55, 32, 8, pixel_pitch=1e-3)
    strehl_table()
    axial_pictures()
    distortion()
    flux()
    knobs()
