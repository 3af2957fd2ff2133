"""Functions whose Sobol' indices are known in closed form."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np


@dataclass(frozen=True)
class Known:
    """A function of numbers between 0 and 1, with its indices."""

    name: str
    function: Callable[[Any], Any]
    first: Any
    total: Any


def ishigami(x: Any) -> Any:
    """With a factor that does nothing, x[3]. Ishigami and Homma 1990, a = 7, b = 0.1."""
    a, b, c = (np.pi * (2 * x[n] - 1) for n in range(3))
    return np.sin(a) + 7 * np.sin(b) ** 2 + 0.1 * c**4 * np.sin(a)


WEIGHTS = np.array([0, 1, 4.5, 9, 99, 99])


def g_function(x: Any) -> Any:
    """Saltelli and Sobol' 1995."""
    return np.prod([(np.abs(4 * own - 2) + a) / (1 + a) for own, a in zip(x, WEIGHTS, strict=True)], axis=0)


def _of_ishigami() -> Known:
    first = np.array([0.5 * (1 + 0.1 * np.pi**4 / 5) ** 2, 49 / 8, 0, 0])
    both = 0.01 * np.pi**8 * (1 / 18 - 1 / 50)
    whole = first.sum() + both
    return Known("ishigami", ishigami, first / whole, (first + both * np.array([1, 0, 1, 0])) / whole)


def _of_g() -> Known:
    own = 1 / 3 / (1 + WEIGHTS) ** 2
    whole = np.prod(1 + own) - 1
    return Known("g-function", g_function, own / whole, own * np.prod(1 + own) / (1 + own) / whole)


ISHIGAMI, G = _of_ishigami(), _of_g()
FUNCTIONS = (ISHIGAMI, G)
