"""Orders of convergence: the law by which an error falls along the settings of a knob, and the error that remains at
the last setting.

In:  settings with their errors.
Out: numbers; nothing is run here.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq

from etendue.plan.expansion.search import Value
from etendue.types.arrays import FloatArray

ROUNDING = 3e-15  # smaller errors are rounding in 64 bits
LARGEST = 0.1  # larger errors do not converge yet
PLATEAU = 0.9  # errors that fall by less have reached a plateau
ALIKE = 1.5  # an order counts as known if the local orders differ by at most this factor
FEW, ROUNDED, IRREGULAR = "fewer than three settings", "errors at rounding", "not in the asymptotic regime"


@dataclass(frozen=True)
class Convergence:
    """``order``: the error falls with this power of the setting (``algebraic``), or by exp(-order) per unit of the
    setting (``geometric``). ``order`` is None if fewer than three settings show an order, or if local orders differ too
    much.
    """

    order: float | None
    law: str
    settings: tuple[float, ...] = ()  # the settings it is fitted to
    why: str = ""  # why no order is known; '' also for settings that are not numbers


def convergence(
    settings: Sequence[Value], errors: Sequence[float | None], floor: float = 0.0, reference: float | None = None
) -> Convergence:
    """Return the law by which errors fall from setting to setting, power law or geometric, whichever has the smaller
    residual in log error.

    The order is the median of the local orders between neighbouring settings, taken over the four finest settings that
    show an order, if these local orders agree. Settings from which the error falls by less than a tenth are ignored,
    because another error dominates there. A geometric law can be recognised only for counts that are not doubled from
    setting to setting.

    Parameters
    ----------
    settings : settings from the cheapest to the finest; those that are not positive finite numbers are ignored
    errors : error of each setting
    floor : possible error of the reference itself; errors below ten times this value are ignored
    reference : setting relative to which errors are measured, if it is finite. Under a power law h^p the
        differences are h^p - r^p, which fall faster than the error itself.
    """
    least = max(10 * floor, ROUNDING)
    used = _falling(settings, errors, least)
    if len(used) < 3:
        return Convergence(None, "", tuple(s for s, _ in used), _why_not(settings, errors, least))
    size, error = (np.array(values) for values in zip(*used, strict=True))
    finer = 1.0 if size[-1] > size[0] else -1.0
    fits = {}
    counted = finer > 0 and np.all(size % 1 == 0) and np.all(size[1:] < 2 * size[:-1])
    for law, along in (("algebraic", np.log(size)), *([("geometric", size)] if counted else [])):
        slope, start = np.polyfit(along, np.log(error), 1)
        local = -finer * np.diff(np.log(error)) / np.diff(along)
        if law == "algebraic" and reference is not None:
            local = _beside_a_finite_reference(local, size**-finer, error, reference**-finer)
        rate = np.median(local[-3:]) if law == "algebraic" else -finer * slope
        if 0 < max(local[-3:]) <= ALIKE * min(local[-3:]):
            fits[law] = float(np.sum((np.log(error) - slope * along - start) ** 2)), float(rate)
    law = min(fits, key=lambda name: fits[name], default="")
    return Convergence(fits[law][1] if law else None, law, tuple(map(float, size)), "" if law else IRREGULAR)


def _why_not(settings: Sequence[Value], errors: Sequence[float | None], least: float) -> str:
    """Return the reason why the settings give no order of convergence; '' if no setting is a positive finite number."""
    numbers = [e or 0.0 for s, e in zip(settings, errors, strict=True) if _is_size(s)]
    above = sum(e > least for e in numbers)
    if not numbers:
        return ""
    return ROUNDED if not above and any(numbers) else FEW if above < 3 else IRREGULAR


def _is_size(setting: Value) -> bool:
    return not isinstance(setting, bool | str) and 0 < setting < math.inf


def _falling(settings: Sequence[Value], errors: Sequence[float | None], least: float) -> list[tuple[float, float]]:
    """Return settings and errors as long as the error falls from each to the next."""
    numbers = [(s, e or 0.0) for s, e in zip(settings, errors, strict=True) if _is_size(s)]
    used = [(float(s), float(e)) for s, e in numbers if least < e < LARGEST]
    falling = [i for i in range(len(used) - 1) if min(e for _, e in used[i + 1 :]) < PLATEAU * used[i][1]]
    if not falling or falling[-1] < len(used) - 2:  # at finer settings another error dominates
        return used[: falling[-1] + 1] if falling else []
    return used


def _beside_a_finite_reference(local: FloatArray, step: FloatArray, error: FloatArray, last: float) -> FloatArray:
    """Correct local orders for a finite reference: find the p for which h^p - r^p falls as measured; an order without
    such a p is unchanged.
    """
    found = []
    for i, plain in enumerate(local):
        fallen = math.log(error[i] / error[i + 1])

        def lacking(
            order: float, large: float = step[i] / last, small: float = step[i + 1] / last, fallen: float = fallen
        ) -> float:
            ratio = math.log(large / small) * order  # log of the expected ratio, without overflow
            return ratio + math.log1p(-(large**-order)) - math.log1p(-(small**-order)) - fallen

        solvable = step[i] > step[i + 1] > last and plain > 0 and lacking(1e-3) < 0 < lacking(plain)
        found.append(brentq(lacking, 1e-3, plain) if solvable else plain)
    return np.array(found)


def law_of(settings: Sequence[Value], errors: Sequence[float | None], finite: bool) -> Convergence:
    """Return the law by which errors relative to the last setting fall; ``finite``: the last setting is not exact."""
    numbers = [float(s) for s in settings if not isinstance(s, bool | str)]
    last = numbers[-1] if finite and numbers and numbers[-1] > 0 else None
    power = last is not None and last < numbers[0]  # a width: the law itself accounts for the finite reference
    lost = 0 if not finite else 1 if power else 2  # one refinement below the reference shows only half of its error
    counted = len(settings) - lost
    return convergence(settings[:counted], errors[:counted], reference=last)


def remaining(settings: Sequence[Value], moved: float, found: Convergence) -> float:
    """Return the possible error of a finite reference: the change by its last refinement or, if an order is known, the
    remainder that follows from the order.
    """
    before, last = settings[-2:]
    if found.order is None or found.order < 0.5 or isinstance(last, bool | str) or isinstance(before, bool | str):
        return moved
    if found.law == "geometric":
        return moved / math.expm1(min(found.order * abs(last - before), 700.0))
    ratio = max(last / before, before / last)
    return float(moved / (ratio**found.order - 1))
