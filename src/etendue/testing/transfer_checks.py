"""Checks of a transfer function: mean, symmetry, height, and that the value at a single band does not depend on the
other bands.

In:  a ``Bench`` whose stage has ``transfer``.
Out: nothing, or ``LawBroken``.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from etendue.compute.tables import prepared_of
from etendue.contract.capabilities import Transfer, ends_in_sum
from etendue.testing.bench import Bench
from etendue.testing.examples import edges
from etendue.testing.measured import hold, within
from etendue.transfer.products import Product
from etendue.types.arrays import Array


def check_transfer(bench: Bench) -> None:
    """Check that the transfer function has the right shape, is 1 at zero frequency, Hermitian and no higher than
    ``gain`` allows; and that a sum over bands has a weight for every band.
    """
    grids = bench.input_grids()
    assert isinstance(bench.stage, Transfer)
    prepared = prepared_of(bench.stage, grids, bench.job().grids)
    bands = edges()
    product = Product((bench.stage,), bands, lambda *_: prepared)
    axis = np.array([-0.7, -0.31, -0.05, 0.0, 0.05, 0.31, 0.7])
    with np.errstate(all="ignore"):
        value = product.at(axis[:, None], axis[None, :])
        line = np.geomspace(1e-6, 1e3, 400)
        whole = product.at(np.zeros((1, 1)), line[None, :])
    bad = ~np.isfinite(whole).reshape(-1, line.size).all(axis=0)
    at = float(line[int(bad.argmax())])
    hold(not bad.any(), f"{bench.name}.transfer is not finite at {at:.4g} um-1: overflow, or zero divided by zero")
    hold(
        value.shape[-2:] == (7, 7) and value.ndim in (2, 3),
        f"{bench.name}.transfer has shape {value.shape}; expected (band, y, x)",
    )
    hold(
        value.ndim == 2 or value.shape[0] in (1, len(bands) - 1),
        f"{bench.name}.transfer has {value.shape[0]} planes for {len(bands) - 1} bands",
    )
    hold(bool(np.isfinite(value).all()), f"{bench.name}.transfer is not finite")
    centre = np.abs(value[..., 3, 3] - 1).max()
    within(centre, 1e-12, f"{bench.name}.transfer is 1 {'+-'} {centre:.2g} at zero frequency: it adds or loses light")
    uneven = np.abs(value[..., ::-1, ::-1] - np.conj(value)).max()
    within(
        uneven,
        1e-12,
        f"{bench.name}.transfer(-f) is {uneven:.2g} from the conjugate of transfer(f): a real image becomes complex",
    )
    check_not_moved(bench, product)
    wide = np.linspace(-3.0, 3.0, 61)
    highest = np.abs(product.at(wide[:, None], wide[None, :])).max()
    limit = max(1.0, bench.stage.gain or 1.0)
    within(
        highest, limit * (1 + 1e-9), f"|{bench.name}.transfer| reaches {highest:.6g}; declare a gain if it may amplify"
    )
    if ends_in_sum(bench.kind):
        weights = np.asarray(bench.stage.weights(prepared))  # type: ignore[attr-defined]
        right = weights.ndim == 2 and weights.shape[1] == len(bands) - 1 and bool(np.isfinite(weights).all())
        hold(
            right, f"{bench.name}.weights has shape {weights.shape}, not (channel, {len(bands) - 1}), or is not finite"
        )


def check_not_moved(bench: Bench, product: Product) -> None:
    """Check that the function does not shift the whole picture, that is, that its phase is not simply proportional to
    the frequency.
    """
    if bench.kind.handed:
        return
    small = np.array([0.005, 0.01, 0.02, 0.04])
    for word, value in (
        ("right", product.at(np.zeros((1, 1)), small[None, :]).reshape(-1, small.size)),
        ("down", product.at(small[:, None], np.zeros((1, 1))).reshape(-1, small.size)),
    ):
        if not np.iscomplexobj(value) or np.abs(value).min() < 1e-3:
            continue
        by = -np.angle(value) / (2 * np.pi * small)  # um
        if np.ptp(by) <= 1e-6 * (1 + np.abs(by).max()):
            within(
                float(np.abs(by).max()),
                1e-9,
                f"{bench.name}.transfer moves the picture {by.flat[0]:.3g} um to the {word}; declare handed = True if "
                "that is intended",
            )


def check_single_bands(bench: Bench) -> None:
    """Check that the transfer function at one band has the same values whether it is evaluated alone or with other
    bands.
    """
    grids = bench.input_grids()
    prepared = prepared_of(bench.stage, grids, bench.job().grids)
    given = [np.linspace(-0.6, 0.6, 5)[:, None], np.linspace(-0.4, 0.9, 6)[None, :]]
    bands = edges()
    middle = 0.5e-3 * (np.array(bands[:-1]) + np.array(bands[1:]))[:, None, None]
    last = [] if prepared is None else [prepared]
    whole = np.asarray(bench.stage.transfer(*given, middle, *last))  # type: ignore[attr-defined]
    one = np.asarray(bench.stage.transfer(*given, middle[2:3], *last))  # type: ignore[attr-defined]
    wanted = whole[2] if whole.ndim == 3 and whole.shape[0] > 1 else whole.reshape(one.shape[-2:])
    apart = np.abs(one.reshape(wanted.shape) - wanted).max()
    within(apart, 1e-12, f"{bench.name}.transfer at one band differs by {apart:.2g} from its value among others")


def check_mixture(bench: Bench, light: Array) -> None:
    """Check that the weighted sums of the planes that ``mixture`` returns equal the light that the source writes."""
    source: Any = bench.stage
    mixture = source.mixture(prepared_of(source, bench.input_grids(), bench.job().grids))
    if mixture is not None:
        planes, weights = mixture
        apart = np.abs(np.tensordot(weights, np.stack(planes), 1) - light).max() / (np.abs(light).max() or 1.0)
        within(apart, 1e-6, f"{bench.name}.mixture differs by {apart:.2g} of the largest value from the output of run")
