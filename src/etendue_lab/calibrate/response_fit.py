"""Gain and response of a sensor from means and variances of levels: the simplest model that the residuals accept.

In:  a photon transfer curve.
Out: gain, rate, bend with standard errors, and the tests that chose the model.
Sources: Janesick 2007 (photon transfer with a response that bends): of a signal s, the mean is g(s) and its variance
g'(s)^2 (K s + dark); F tests of nested least squares, at 1 % over the number of tests.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import scipy

from etendue.errors import RequestError
from etendue_camera.arrays import Array
from etendue_camera.electronics.emva import QUANTISATION
from etendue_lab.frames.transfer import Curve

LEVEL = 0.01
ORDERS = (1.0, 2.0, 3.0)
PARTS = 4
SEEN = 0.45  # DN^2: above it rounding adds 1/12 to a variance within 0.1 %, whatever the mean
CLIPPED = 1e-3  # largest share of pixels at the top code


@dataclass(frozen=True)
class ResponseFit:
    """The fitted response. Errors are standard errors, scaled by the lack of fit."""

    gain: float  # DN/electron, at the dark
    rate: float  # DN per photon, or per unit of light
    bend: float
    order: float
    offset: float  # DN, of all light levels: light outside the exposure time
    errors: dict[str, float]
    full: float  # DN above the dark where the bend is defined
    tests: tuple[str, ...]
    lack: tuple[float, float]  # rms of residuals of means and variances over their own errors
    mean_scatter: float  # relative, of means about the response: of the light
    used: Array
    freedom: float
    floor: float | None = None  # DN^2, variance without light, where the dark does not show it

    def parameters(self) -> dict[str, float]:
        """Return what was fitted, by name."""
        found = {"gain": self.gain, "rate": self.rate}
        found |= {"bend": self.bend} if self.bend else {}
        found |= {"offset": self.offset} if self.offset else {}
        return found | ({"floor": self.floor} if self.floor is not None else {})

    def mean(self, light: Array, charge: Array | float = 0.0) -> Array:
        """Return the expected signal, DN above the dark, on a dark charge of so many DN."""
        s = self.rate * light + self.offset
        return self.bent(s + charge) - self.bent(np.asarray(charge))

    def bent(self, s: Array) -> Array:
        return np.asarray(s * (1 - self.bend * (np.maximum(s, 0) / self.full) ** self.order))

    def slope(self, s: Array) -> Array:
        return np.asarray(1 - self.bend * (self.order + 1) * (np.maximum(s, 0) / self.full) ** self.order)

    def variance_at(self, signal: Array, dark: Array, charge: Array | float = 0.0) -> Array:
        """Return the expected temporal variance at a measured mean, DN above the dark; ``charge``: of the dark, DN,
        whose noise is not in ``dark``.
        """
        signal = signal + charge
        s = signal
        if self.bend:
            most = self.full * (0.999 / (abs(self.bend) * (self.order + 1))) ** (1 / self.order)
            for _ in range(12):  # Newton; the loss is a few per cent
                s = np.clip(s - (s * (1 - self.bend * (np.maximum(s, 0) / self.full) ** self.order) - signal)
                            / np.maximum(self.slope(s), 1e-3), 0, most)  # fmt: skip
        dark = dark - QUANTISATION if self.floor is None else np.full(np.shape(signal), self.floor)
        return np.asarray(self.slope(s) ** 2 * (self.gain * s + dark) + QUANTISATION)

    def straight(self, light: Array) -> Array:
        return np.asarray(self.rate * light + self.offset)


def fit(curve: Curve) -> ResponseFit:
    """Fit the response of a curve; levels up to 95 % of saturation in which hardly a pixel clips."""
    clipped = np.array([one.share_at(curve.top) if one.top == curve.top else 0.0 for one in curve.moments])
    used = curve.between(0.0, 0.95) & (clipped <= CLIPPED)
    if curve.hidden:  # nor is the noise of faint levels seen
        cut = np.array([one.histogram[0] / one.histogram.sum() for one in curve.moments])
        used &= (curve.variance[0] > SEEN) & (cut <= CLIPPED)
        if np.count_nonzero(used) < 3:
            raise RequestError(
                f"three levels with noise above {SEEN} DN^2 and without clipped pixels are needed; or {curve.hidden}"
            )
    bits = max(1, math.ceil(math.log2(curve.top + 1)))
    light, signal, variance = curve.exposure[used], curve.signal[0, used], curve.variance[0, used]
    dark = np.full(light.size, _flat(curve))
    frames = np.array([one.frames for one in curve.moments])[used]
    pixels = curve.moments[0].pixels
    statistical = np.sqrt(
        variance / frames / pixels + curve.dark_variance[0, used] / sum(one.frames for one in curve.dark) / pixels
    )
    scatter = _scatter(light, signal, statistical)
    errors = (
        np.hypot(np.hypot(statistical, scatter * signal), 1e-6 * signal),
        np.sqrt(2 / (frames - 1) / pixels) * variance,
    )
    problem = _Problem(
        light,
        signal,
        variance,
        dark,
        errors,
        float(2**bits - 1),
        *_charge(curve, used),
        np.ones(light.size, bool),
        bool(curve.hidden),
    )
    problem = problem.with_sound_labels()
    best, _ = problem.with_own_scatter().chosen()
    problem = problem.with_own_scatter(best)  # about the chosen model, from sampling errors alone
    best, tests = problem.chosen()
    if not problem.sound.all():
        odd = ", ".join(f"{one:.6g}" for one in light[~problem.sound])
        tests.append(f"the means of levels labelled {odd} do not fit their light; only their variances are used")
    lack = problem.lack(best)
    covariance = problem.covariance(best, lack)
    names = list(best.parameters())
    errors_of = np.sqrt(np.diag(covariance))
    p = _p_random(problem.residuals(best)[1])
    tests.append(f"variances scatter about the model at random from level to level: p = {p:.2g}, refused below {LEVEL}")
    if p < LEVEL:
        errors_of = np.hypot(errors_of, problem.without_parts(best))
        tests.append("the model does not hold: intervals include its change where a quarter of the levels is left out")
    return replace(
        best,
        errors=dict(zip(names, errors_of, strict=True)),
        tests=tuple(tests),
        lack=lack,
        mean_scatter=scatter,
        used=used,
        freedom=max(1.0, float(light.size - len(names) / 2)),
    )


def _charge(curve: Curve, used: Array) -> tuple[Array, float]:
    """Return the dark charge of light levels, and its mean over the dark levels, DN."""
    if curve.dark_slope is None:
        return np.zeros(np.count_nonzero(used)), 0.0
    slope = max(float(curve.dark_slope[0]), 0.0)
    weight = np.array([one.frames - 1.0 for one in curve.dark])
    times = np.nan_to_num(np.array([one.time for one in curve.dark]))
    own = np.nan_to_num(np.array([one.time for one in curve.moments]))[used]
    return slope * own, slope * float((weight * times).sum() / weight.sum())


def _flat(curve: Curve) -> float:
    weight = np.array([one.frames - 1.0 for one in curve.dark])
    return float((np.array([one.variance[0] for one in curve.dark]) * weight).sum() / weight.sum())


def _scatter(light: Array, signal: Array, statistical: Array) -> float:
    """Return the relative scatter of means about a smooth response beyond statistics, from neighbouring levels."""
    if light.size < 6:
        return 0.0
    share, x = signal / light, light
    middle = share[1:-1] - (share[:-2] * (x[2:] - x[1:-1]) + share[2:] * (x[1:-1] - x[:-2])) / np.maximum(
        x[2:] - x[:-2], 1e-300
    )
    keep = signal[1:-1] > 0.05 * signal.max()
    if np.count_nonzero(keep) < 4:
        return 0.0
    own = 1.4826 * np.median(np.abs(middle[keep] / share[1:-1][keep])) / math.sqrt(1.5)
    usual = float(np.median((statistical / signal)[1:-1][keep]))
    # the median of thirty levels is known to a fifth: what is within it is no scatter of its own
    return math.sqrt(max(float(own) ** 2 - usual**2, 0.0)) if own > 1.4 * usual else 0.0


@dataclass(frozen=True)
class _Problem:
    light: Array
    signal: Array
    variance: Array
    dark: Array
    errors: tuple[Array, Array]
    full: float
    charge: Array  # DN, of the dark at each level
    usual: float  # DN, the dark charge at which ``dark`` was measured
    sound: Array  # levels whose means fit their light
    hidden: bool  # the dark does not show its noise

    def residuals(self, fit: ResponseFit) -> tuple[Array, Array]:
        """Return residuals of means, and of variances at the measured means, over their errors."""
        return (
            ((fit.mean(self.light, self.charge) - self.signal) / self.errors[0])[self.sound],
            (self.expected(fit) - self.variance) / self.errors[1],
        )

    def expected(self, fit: ResponseFit) -> Array:
        """Return the expected variances of the levels."""
        return fit.variance_at(self.signal, self.dark - fit.gain * self.usual, self.charge)

    def flexible(self, loss: str = "linear") -> ResponseFit:
        """Return the closest of all models."""
        return min((self.fitted(one, True, loss) for one in (0.0, *ORDERS)), key=lambda one: one[1])[0]

    def with_sound_labels(self) -> _Problem:
        """Leave out means that lie far from what their light gives: beyond 8 robust errors and 0.3 %."""
        # with wide errors and a loss that grows as the distance, one wrong label moves the others little
        wide = replace(self, errors=(np.hypot(self.errors[0], 1e-3 * self.signal), self.errors[1]))
        found, sound = wide.flexible("soft_l1"), self.sound
        for _ in range(3):
            away = (self.signal - found.mean(self.light, self.charge)) / self.signal
            bright = self.signal > 0.05 * self.signal.max()
            usual = 1.4826 * float(np.median(np.abs(away[bright])))
            before, sound = sound, ~bright | (np.abs(away) < max(8 * usual, 3e-3))
            if (sound == before).all() or np.count_nonzero(sound) < 4:
                return replace(self, sound=before)
            found = replace(wide, sound=sound).flexible("soft_l1")
        return replace(self, sound=sound)

    def with_own_scatter(self, fit: ResponseFit | None = None) -> _Problem:
        """Add to the errors of variances what scatters beyond them, the same share of every level."""
        fit = fit or self.flexible()
        away = (self.variance - self.expected(fit)) / self.variance
        own = self.errors[1] / self.variance
        freedom = max(away.size - 3, 1)
        extra = 0.0
        if float((away**2 / own**2).sum()) > float(scipy.special.chdtri(freedom, 0.01)):  # else it is no scatter
            extra = float(
                scipy.optimize.brentq(
                    lambda t: float((away**2 / (own**2 + t**2)).sum()) - freedom, 0, 10 * away.std() + 1
                )
            )
        return replace(self, errors=(self.errors[0], np.hypot(self.errors[1], extra * self.variance)))

    def lack(self, fit: ResponseFit) -> tuple[float, float]:
        parts = self.residuals(fit)
        count = (2 if fit.bend else 1) + bool(fit.offset)
        return tuple(  # type: ignore[return-value]
            math.sqrt(float((one**2).sum()) / max(one.size - used, 1))
            for one, used in zip(parts, (count, 1), strict=True)
        )

    def model(self, values: Array, order: float, offset: bool) -> ResponseFit:
        rest = list(values[2:])
        bend = rest.pop(0) if order else 0.0
        return ResponseFit(
            float(values[0]), float(values[1]), float(bend), order or 1.0, float(rest.pop(0)) if offset else 0.0,
            {}, self.full, (), (1.0, 1.0), 0.0, np.zeros(0), 1.0, float(rest.pop(0)) if self.hidden else None,
        )  # fmt: skip

    def fitted(self, order: float, offset: bool, loss: str = "linear") -> tuple[ResponseFit, float]:
        """Return the best model of a kind, and its sum of squares."""
        rate = float((self.signal * self.light).sum() / (self.light**2).sum())
        gain = float(np.median((self.variance - self.dark) / self.signal))
        start = [gain, rate, *([0.01] if order else []), *([0.0] if offset else []), *([0.1] if self.hidden else [])]
        scale = [abs(gain), abs(rate), *([0.01] if order else []), *([0.1] if offset else [])]
        scale += [0.1] if self.hidden else []
        most = 0.95 / (order + 1) if order else 0.0
        lower = [0.0, 0.0, *([-most] if order else []), *([-np.inf] if offset else []), *([0.0] if self.hidden else [])]
        upper = [
            np.inf,
            np.inf,
            *([most] if order else []),
            *([np.inf] if offset else []),
            *([np.inf] if self.hidden else []),
        ]
        found = scipy.optimize.least_squares(
            lambda v: np.concatenate(self.residuals(self.model(v, order, offset))),
            start, x_scale=scale, bounds=(lower, upper), loss=loss, xtol=1e-14, ftol=1e-14, gtol=1e-14,
        )  # fmt: skip
        return self.model(found.x, order, offset), 2 * float(found.cost)

    def chosen(self) -> tuple[ResponseFit, list[str]]:
        """Add to constant gain what an F test accepts: a bend of one of three orders, light outside the exposure."""
        size, tests = 2 * self.light.size, []
        share = LEVEL / (len(ORDERS) + 1)
        order = 0.0
        # the bend is tested beside the offset, which would otherwise be taken for one
        bends = {one: self.fitted(one, True) for one in ORDERS}
        likely = min((one for one in ORDERS if bends[one][0].bend > 0), key=lambda one: bends[one][1], default=0.0)
        straight, straight_cost = self.fitted(0.0, True)
        if likely:
            p = _p_value(straight_cost, bends[likely][1], size - 4)
            tests.append(f"a bend of order {likely:g} against constant gain: p = {p:.2g}, accepted below {share:.2g}")
            order = likely if p < share else 0.0
        else:
            tests.append("no bend of order 1, 2 or 3 lowers the response: constant gain")
        without, without_cost = self.fitted(order, False)
        with_, with_cost = bends[order] if order else (straight, straight_cost)
        p = _p_value(without_cost, with_cost, size - 3 - bool(order))
        tests.append(f"light outside the exposure time: p = {p:.2g}, accepted below {share:.2g}")
        offset = p < share
        return with_ if offset else without, tests

    def without_parts(self, fit: ResponseFit) -> Array:
        """Return standard errors from fits without each quarter of the levels, by light (a jackknife of blocks)."""
        order = fit.order if fit.bend else 0.0
        found = []
        for left in np.array_split(np.arange(self.light.size), PARTS):
            keep = np.setdiff1d(np.arange(self.light.size), left)
            rest = replace(
                self, light=self.light[keep], signal=self.signal[keep], variance=self.variance[keep],
                dark=self.dark[keep], charge=self.charge[keep], sound=self.sound[keep],
                errors=(self.errors[0][keep], self.errors[1][keep]),
            )  # fmt: skip
            one, _ = rest.fitted(order, bool(fit.offset))
            found.append([{**fit.parameters(), **one.parameters()}[name] for name in fit.parameters()])
        values = np.array(found)
        return np.asarray(np.sqrt((PARTS - 1) / PARTS * ((values - values.mean(0)) ** 2).sum(0)))

    def covariance(self, fit: ResponseFit, lack: tuple[float, float]) -> Array:
        """Return the covariance of the parameters; errors are scaled up by the lack of fit of their kind."""
        values = list(fit.parameters().values())
        order = fit.order if fit.bend else 0.0

        def at(v: list[float]) -> Array:
            parts = self.residuals(self.model(np.array(v), order, bool(fit.offset)))
            return np.concatenate([one / max(own, 1.0) for one, own in zip(parts, lack, strict=True)])

        columns = []
        for i, value in enumerate(values):
            step = 1e-5 * max(abs(value), 1e-6)
            ends = [at([v + sign * step * (j == i) for j, v in enumerate(values)]) for sign in (1, -1)]
            columns.append((ends[0] - ends[1]) / (2 * step))
        design = np.stack(columns, 1)
        return np.asarray(np.linalg.pinv(design.T @ design, rcond=1e-15, hermitian=True))


def _p_random(residuals: Array) -> float:
    """Return the p value that successive residuals are independent (von Neumann's ratio, one-sided)."""
    n = residuals.size
    if n < 6:
        return 1.0
    away = residuals - residuals.mean()
    ratio = float((np.diff(residuals) ** 2).sum() / (away**2).sum())
    return float(scipy.special.ndtr((ratio - 2) / math.sqrt(4 * (n - 2) / (n * n - 1))))


def _p_value(without: float, with_: float, freedom: int) -> float:
    """Return the p value of one more parameter."""
    if freedom < 1 or with_ <= 0:
        return 1.0
    return float(scipy.special.fdtrc(1, freedom, max(without - with_, 0.0) / (with_ / freedom)))
