"""Non-linear response: the output charge grows more slowly than the collected charge.

In:  charge (electrons), the relative loss at full scale, its order.
Out: output charge (electrons), and its inverse.
Sources: Janesick 2007, "Photon Transfer", ch. 7 (V/V and V/e- non-linearity: the capacitance of the sense node grows
with its charge, the gain of the source follower falls): to lowest order a loss that is a power of the signal.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from etendue import require
from etendue_camera.arrays import Floats

ROUNDS = 60  # of the inverse; Newton's method needs 4 to 8, and 60 only at the turning point


def bent(charge: ArrayLike, bend: float, order: float, full: float) -> NDArray:
    """Return the output charge of a non-linear response.

    Parameters
    ----------
    charge : (...) array, electrons
        Any sign; charge at or below 0 is returned unchanged.
    bend : float, dimensionless
        Relative loss at ``full``, at least 0 and below 1 / (order + 1), so that the response rises up to ``full``.
    order : float
        Power of the loss, 0.5 to 8: 1 for a capacitance that grows with its charge.
    full : float, electrons
        Above 0.

    Returns
    -------
    (...) array, electrons, dtype of the charge
        q (1 - bend (q / full)^order); beyond the maximum of this function its maximum, so that the output never falls.

    Raises
    ------
    ValueError
        If a number is outside the range named above.

    Notes
    -----
    Error: 4 roundings, 5e-16 relative in float64 and 3e-7 in float32.
    """
    check(bend, order, full)
    charge = np.asarray(charge)
    kind = charge.dtype.type if np.issubdtype(charge.dtype, np.floating) else np.float64
    if bend == 0:
        return charge.astype(kind, copy=False)
    turning = _turning(bend, order)
    share = np.clip(charge * kind(1 / full), kind(0), kind(turning))
    inside = np.where(np.isposinf(charge), kind(turning * full), np.minimum(charge, kind(turning * full)))
    return inside * (kind(1) - kind(bend) * share ** kind(order))


def unbent(charge: Floats, bend: float, order: float, full: float) -> NDArray:
    """Return the charge before a non-linear response: the inverse of `bent`.

    Parameters
    ----------
    charge : (...) array, electrons
    bend, order, full : float
        As in `bent`.

    Returns
    -------
    (...) array of float64, electrons
        For outputs at or above the maximum of the response, the charge at that maximum.

    Raises
    ------
    ValueError
        If a number is outside the range named in `bent`.

    Notes
    -----
    Newton's method on a concave function, started on the left, converges from below without overshoot. Error: 2e-15
    relative for charges up to ``full`` and bends up to half of the largest; near the maximum of the response the error
    grows to the square root of the rounding error.
    """
    check(bend, order, full)
    wanted = np.asarray(charge, dtype=np.float64) / full
    if bend == 0:
        return wanted * full
    turning = _turning(bend, order)
    most = turning * (1 - bend * turning**order)
    target = np.clip(wanted, 0, most)
    found = target.copy()
    for _ in range(ROUNDS):
        slope = 1 - bend * (order + 1) * found**order
        step = np.where(slope > 1e-9, (found * (1 - bend * found**order) - target) / np.maximum(slope, 1e-9), 0.0)
        found = np.clip(found - step, target, turning)
        if np.abs(step).max(initial=0.0) <= 1e-16:
            break
    return np.where(wanted <= 0, wanted, np.where(wanted >= most, turning, found)) * full


def _turning(bend: float, order: float) -> float:
    """Return the charge at the maximum of the response, relative to ``full``; at most 1e9."""
    return float(np.exp(min(-np.log(bend * (order + 1)) / order, np.log(1e9))))


def check(bend: float, order: float, full: float) -> None:
    """Raise ValueError for numbers out of range, such as a bend with which the response falls before full scale."""
    require.that(0.5 <= order <= 8, f"response_order is {order!r}; it must be from 0.5 to 8")
    require.that(
        0 <= bend < 1 / (order + 1),
        f"response_bend is {bend!r}; it must be at least 0 and below {1 / (order + 1):.4g}, where the response turns",
    )
    require.that(full > 0, f"full is {full!r} electrons; it must be above 0")
