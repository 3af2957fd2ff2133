"""Information along a camera: capacity against closed forms, NEQ predicted and found, losses of pairs predicted and
measured.

    python benchmarks/information.py [--frames 64 | 0] [--pipeline pipelines/paper_physical.toml] [--no-colour]

A claim is printed with its bound; what misses it is marked and makes the exit code 1. Measured are real runs: frames of
noise, edges without noise of cameras from which the stages were taken, and pictures of the scene.
"""

from __future__ import annotations

import argparse
import math
import sys
from dataclasses import replace
from itertools import combinations
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import scipy

from etendue.contract.registry import installed_stages
from etendue.pipeline.file import read_pipeline
from etendue.plan.planner import make_plan
from etendue_camera.resolution import information as kernel
from etendue_lab.compare.axis import without_sweep
from etendue_lab.information.edge_contrast import edge_contrast
from etendue_lab.information.fine_detail import fine_detail, frames
from etendue_lab.information.study import information
from etendue_lab.losses.games import Contrast
from etendue_lab.losses.shapley import shares
from etendue_lab.losses.study import losses, without_stages
from etendue_lab.quality.ideal import ideal_of

MISSED: list[str] = []
REGISTRY = installed_stages()


def claim(what: str, bound: str, measured: str, holds: bool) -> None:
    print(f"  {what:72s} {bound:>12s} {measured:>28s}{'' if holds else '   MISSED'}")
    if not holds:
        MISSED.append(what)


def closed_forms() -> None:
    print("information capacity, bits a pixel, against closed forms (bound: 1 %)")
    square = kernel.nyquist_square()
    fy, fx = square.fy[:, None], square.fx
    radius = np.hypot(fy, fx)

    def of(name: str, quanta: Any, expected: float, variance: float = 1.0) -> None:
        found = kernel.capacity(quanta, square, variance)
        claim(
            name, f"{expected:.6f}", f"{found:.6f} ({abs(found / expected - 1):.1e})", abs(found / expected - 1) < 0.01
        )

    for electrons in (100.0, 1e4):
        of(
            f"white noise, no blur, {electrons:g} electrons, 4:1",
            np.full((1, 1), electrons),
            0.5 * math.log2(1 + 0.12 * electrons),
            0.12,
        )
    for snr in (10.0, 1e4):
        a = 4 * (math.pi * 1.5) ** 2
        of(
            f"Gaussian of 1.5 pixels, SNR {snr:g}: -pi Li2(-SNR) / (2 a ln 2)",
            snr * np.exp(-a * radius**2),
            -math.pi / (2 * a * math.log(2)) * float(scipy.special.spence(1 + snr)),
        )
    of(
        "square pixel, SNR 1e8: 0.5 log2 SNR + 2 (1 - ln pi) / ln 2",
        1e8 * (np.sinc(fy) * np.sinc(fx)) ** 2,
        0.5 * math.log2(1e8) + 2 * (1 - math.log(math.pi)) / math.log(2),
    )

    def ring(f: float, snr: float) -> float:
        return float(math.pi * f * math.log2(1 + snr * airy(np.array(f / 0.4)) ** 2))

    for snr in (10.0, 1e3):
        expected = float(scipy.integrate.quad(ring, 0, 0.4, args=(snr,), epsabs=1e-12)[0])
        of(f"diffraction that ends at 0.4 cycles/pixel, SNR {snr:g}: by rings", snr * airy(radius / 0.4) ** 2, expected)
    along = kernel.capacity_along(lambda f: 1e8 * np.sinc(f) ** 2, 1.0)
    line = 0.5 * math.log2(1e8) + (1 - math.log(math.pi)) / math.log(2)
    claim(
        "along a line: square pixel, SNR 1e8",
        f"{line:.6f}",
        f"{along:.6f} ({abs(along / line - 1):.1e})",
        abs(along / line - 1) < 0.01,
    )
    print("the ideal observer")
    for sigma in (1.0, 2.0, 4.0):
        expected = math.sqrt(1000 * math.pi) * sigma
        found = kernel.ideal_observer(np.full((1, 1), 1e3), kernel.gaussian_object(fy, fx, sigma), square)
        claim(
            f"Gaussian of {sigma:g} pixels in white noise: sqrt(pi NEQ) sigma",
            f"{expected:.4f}",
            f"{found:.4f} ({abs(found / expected - 1):.1e})",
            abs(found / expected - 1) < 0.01,
        )


def airy(r: Any) -> Any:
    r = np.minimum(r, 1.0)
    return 2 / np.pi * (np.arccos(r) - r * np.sqrt(1 - r * r))


def quanta(pipeline: Any, count: int) -> None:
    report = information(pipeline, REGISTRY, count=count)
    print(
        f"NEQ of the linear pictures of {pipeline.name}, largest difference along x between found and predicted "
        f"(bound: 5 %)"
    )
    for curve in report.curves:
        about = f"{100 * curve.apart:.1f} % ({curve.periodograms} periodograms)"
        claim(f"{curve.stage} {curve.channel}", "5 %", about, curve.apart < 0.05 and curve.periodograms >= 400)


def pairs(pipeline: Any, count: int, colour: bool) -> None:
    alone, _ = without_sweep(pipeline)
    report = losses(alone, REGISTRY, runs=64 if colour else 0)
    by_name = {game.name: game for game in report.games}
    contrast, snr = by_name["contrast"], by_name["SNR"]
    seen = Edges(alone)
    noisy = Frames(alone, count)
    for game, measured in ((contrast, seen), (snr, noisy)):
        print(
            f"{game.name}: what pairs lose, dB: predicted from shares, and measured without both (bound: 5 % of "
            f"{game.shares.gross:.2f} dB)"
        )
        against(game, {pair: found for pair in game.pairs if (found := measured.lost(pair)) is not None})
    if colour:
        game = by_name["colour"]
        print(f"colour: mean squared CIEDE2000, pictures without both (bound: 5 % of {game.shares.gross:.1f})")
        against(game, {pair: found for pair, (_, found) in game.pairs.items()})


def why_decibels(pipeline: Any) -> None:
    """Pairs of contrast from shares of contrast itself, and from shares of its decibels."""
    game = Contrast(fine_detail(without_sweep(pipeline)[0], REGISTRY, 0.18))
    every = frozenset(game.players)
    print("pairs of contrast: largest error of what shares predict, of a pair's own loss (of what is lost by all)")
    for name, loss in (("contrast itself", lambda present: 1 - game.contrast(present)), ("decibels", game.loss)):
        found = shares(loss, game.players, 1024)
        errors = []
        for pair in combinations(game.players, 2):
            lost = loss(every) - loss(every - set(pair))
            error = abs(found.of_pair(*pair) - lost)
            errors.append((error / max(abs(lost), 0.05 * found.gross), error / found.gross))
        own, gross = (100 * max(column) for column in zip(*errors, strict=True))
        print(f"  {name:72s} {own:10.1f} % ({gross:.1f} %)")


def against(game: Any, measured: dict[tuple[str, str], float]) -> None:
    gross = game.shares.gross
    for pair in combinations(game.shares.players, 2):
        if pair not in measured:
            continue
        predicted, found = game.shares.of_pair(*pair), measured[pair]
        own = f"{100 * abs(predicted - found) / abs(found):.1f} % of its own" if found else ""
        claim(
            f"{' and '.join(pair)}: {predicted:.3f}, {found:.3f} ({own})",
            "5 %",
            f"{100 * abs(predicted - found) / gross:.2f} %",
            abs(predicted - found) < 0.05 * gross,
        )


class Edges:
    """Mean contrast up to Nyquist across a rendered edge, in the green of the last camera primaries."""

    def __init__(self, pipeline: Any) -> None:
        self.pipeline, self.detail = pipeline, fine_detail(pipeline, REGISTRY, 0.18)
        x, w = np.polynomial.legendre.leggauss(32)
        self.frequency, self.weight = 0.25 * (1 + x), 0.5 * w
        self.full = self.contrast(())

    def lost(self, pair: tuple[str, str]) -> float:
        """dB."""
        return 20 * math.log10(self.contrast(pair) / self.full)

    def contrast(self, out: tuple[str, ...]) -> float:
        pixel = self.detail.pixel
        demosaic = next(stage for stage, variable in self.detail.answers if variable == "rgb_camera")
        base = self.pipeline
        if pixel in out:
            base = replace(
                base, shared={**base.shared, "aperture_fraction": 0.02}
            )  # a point, but for 0.01 % at Nyquist
        gone = set(out) - {pixel}
        if demosaic in gone:
            ideal = ideal_of(base, REGISTRY)
            camera = ideal_of(
                base, REGISTRY, gone - {demosaic} - set(ideal.left_out), set(ideal.left_out) - gone
            ).pipeline
        else:
            camera = without_stages(base, gone)
        plan = make_plan(replace(camera, wanted=None, keep=None), REGISTRY, False)
        last = [n.name for n in plan.nodes if "rgb_camera" in n.writes][-1]
        names = tuple(str(v) for v in plan.cells[last, ()].grids["rgb_camera"]["channel"].values())
        seen = SimpleNamespace(
            pipeline=camera, plan=plan, pitch=self.detail.pitch, mask=self.detail.mask, names_of=lambda place: names
        )
        found = edge_contrast(seen, [(last, "rgb_camera")], 1.0, self.frequency, REGISTRY)  # type: ignore[arg-type]
        return float(self.weight @ np.abs(found[last, "rgb_camera"]["G"]))


class Frames:
    """SNR of green in frames of the grey card, of stages that draw noise or take light, and of sharpening."""

    def __init__(self, pipeline: Any, count: int) -> None:
        self.pipeline, self.count = pipeline, count
        self.detail = fine_detail(pipeline, REGISTRY, 0.18)
        self.cameras = [stage for stage, variable in self.detail.answers if variable == "rgb_camera"]
        self.full = self.snr(())

    def lost(self, pair: tuple[str, str]) -> float | None:
        """dB; None of the shot noise of dark charge and of the demosaicer, which no frame is without."""
        roles = {name: stage.role for name, stage in self.detail.noisy().items()}
        if any(roles.get(name) == "shot noise" or name == self.cameras[0] for name in pair):
            return None
        return 20 * math.log10(self.snr(pair) / self.full)

    def snr(self, out: tuple[str, ...]) -> float:
        detail = self.detail
        light = [name for name in out if name not in detail.noisy() and name not in self.cameras]
        if light:
            detail = fine_detail(without_stages(self.pipeline, light), REGISTRY, 0.18)
        place = ([stage for stage in self.cameras if stage not in out][-1], "rgb_camera")
        every = np.stack(
            [frame[place][1] for frame in frames(detail, REGISTRY, self.count, [n for n in out if n in detail.noisy()])]
        )
        share = detail.electrons["G"] / detail.signal()["G"]
        return float(every.mean() * share / math.sqrt(every.var(axis=0, ddof=1).mean()))


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    root = Path(__file__).resolve().parents[1]
    parser.add_argument("--pipeline", type=Path, default=root / "pipelines" / "paper_physical.toml")
    parser.add_argument("--frames", type=int, default=64, help="of noise; 0: closed forms alone")
    parser.add_argument("--no-colour", action="store_true")
    asked = parser.parse_args()
    pipeline = read_pipeline(asked.pipeline, {})
    closed_forms()
    if asked.frames:
        quanta(pipeline, asked.frames)
        why_decibels(pipeline)
        pairs(pipeline, asked.frames, not asked.no_colour)
    print("missed: " + (", ".join(MISSED) or "none"))
    return 1 if MISSED else 0


if __name__ == "__main__":
    sys.exit(main())
