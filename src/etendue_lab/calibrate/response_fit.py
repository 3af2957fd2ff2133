"""Gain and response of a sensor from means and variances of levels: the simplest model that the residuals do not
reject.

In:  a photon transfer curve.
Out: gain, rate, bend with standard errors, and the tests that chose the model.
Sources: F tests of nested least squares, at 1 % over the number of tests; von Neumann 1941 (successive differences).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy

from etendue.errors import RequestError
from etendue_camera.arrays import Array
from etendue_lab.calibrate.response_model import ResponseFit
from etendue_lab.frames.transfer import Curve

LEVEL = 0.01
ORDERS = (1.0, 2.0, 3.0)
EXTRAS = {  # further parameters of the means, besides gain and bend: description, and initial scale
    "offset": ("light outside the exposure time", 0.1),
    "lamp": ("light that is not proportional to its label", 0.01),
    "leak": ("dark charge, which one exposure time of the dark does not determine", 1.0),
}
DOUBT = 0.05
PARTS = 4
SEEN = 0.45  # DN^2: above this variance, rounding adds 1/12 within 0.1 % for any mean
CLIPPED = 1e-3  # largest share of pixels at the top code


def fit(curve: Curve) -> ResponseFit:
    """Fit the response of a curve to levels up to 95 % of saturation in which at most `CLIPPED` of the pixels clip."""
    clipped = np.array([one.share_at(curve.top) if one.top == curve.top else 0.0 for one in curve.moments])
    used = curve.between(0.0, 0.95) & (clipped <= CLIPPED)
    if curve.hidden:  # the noise of faint levels is then hidden too
        cut = np.array([one.histogram[0] / one.histogram.sum() for one in curve.moments])
        used &= (curve.variance[0] > SEEN) & (cut <= CLIPPED)
        if np.count_nonzero(used) < 3:
            raise RequestError(
                f"three levels with noise above {SEEN} DN^2 and without clipped pixels are needed; or {curve.hidden}"
            )
    bits = max(1, math.ceil(math.log2(curve.top + 1)))
    light, signal, variance = curve.exposure[used], curve.signal[0, used], curve.variance[0, used]
    weight = np.array([one.frames - 1.0 for one in curve.dark])
    flat = float((np.array([one.variance[0] for one in curve.dark]) * weight).sum() / weight.sum())
    dark = np.full(light.size, flat)
    frames = np.array([one.frames for one in curve.moments])[used]
    pixels = curve.moments[0].pixels
    darks = float(sum(one.frames for one in curve.dark))
    statistical = np.sqrt(
        variance / frames / pixels
        + curve.dark_variance[0, used] / darks / pixels
        + curve.line_error(frames)
        + curve.line_error(darks)
    )
    scatter = _scatter(light, signal, statistical)
    errors = (
        np.hypot(np.hypot(statistical, scatter * signal), 1e-6 * signal),
        np.array([one.variance_error(curve.line_noise) for one in curve.moments])[used],
    )
    charge, usual = _charge(curve, used)
    problem = _Problem(
        light, signal, variance, dark, errors, float(2**bits - 1), charge, usual, _after(curve, used),
        np.ones(light.size, bool), bool(curve.hidden),
    )  # fmt: skip
    problem = problem.with_sound_labels()
    best, *_ = problem.with_own_scatter().chosen()
    problem = problem.with_own_scatter(best)  # repeat for the chosen model, starting from sampling errors alone
    best, tests, others = problem.chosen()
    if not problem.sound.all():
        odd = ", ".join(f"{one:.6g}" for one in light[~problem.sound])
        tests.append(f"the means of levels labelled {odd} do not fit their light; only their variances are used")
    lack = problem.lack(best)
    covariance = problem.covariance(best, lack)
    names = problem.names(best)
    errors_of = np.sqrt(np.diag(covariance))
    if others:
        change = [max(abs(getattr(best, name) - getattr(one, name)) for one in others) for name in names]
        errors_of = np.hypot(errors_of, change)
        tests.append(f"{len(others)} other models fit nearly as well: intervals include the differences from them")
    p = _p_random(problem.residuals(best)[1])
    tests.append(f"variances scatter about the model at random from level to level: p = {p:.2g}, refused below {LEVEL}")
    if p < LEVEL:
        errors_of = np.hypot(errors_of, problem.without_parts(best))
        tests.append(
            "the model does not fit: intervals include the change of the fit when a quarter of the levels is omitted"
        )
    return replace(
        best,
        errors=dict(zip(names, errors_of, strict=True)),
        tests=tuple(tests),
        lack=lack,
        mean_scatter=scatter,
        mean_error=float(np.median(problem.errors[0] / problem.signal)),
        used=used,
        freedom=max(1.0, float(light.size - len(names) / 2)),
    )


def _charge(curve: Curve, used: Array) -> tuple[Array, float]:
    """Return the dark charge of each light level, and the mean dark charge of the dark levels, DN."""
    if curve.dark_slope is None:
        return np.zeros(np.count_nonzero(used)), 0.0
    slope = max(float(curve.dark_slope[0]), 0.0)
    weight = np.array([one.frames - 1.0 for one in curve.dark])
    times = np.nan_to_num(np.array([one.time for one in curve.dark]))
    own = np.nan_to_num(np.array([one.time for one in curve.moments]))[used]
    return slope * own, slope * float((weight * times).sum() / weight.sum())


def _after(curve: Curve, used: Array) -> Array:
    """Return each exposure time minus the exposure time of the dark frames, which all have the same, s. Return zeros if
    the dark current cannot be derived from these differences.
    """
    times = np.array([one.time for one in curve.moments])[used]
    known = np.array([one.time for one in curve.dark])
    if curve.dark_slope is not None or np.isnan(times).any() or np.isnan(known).any():
        return np.zeros(times.size)
    after = np.where(np.isclose(times, known[0], rtol=1e-6, atol=0), 0.0, times - known[0])
    light = curve.exposure[used]
    apart = after - light * (light @ after) / (light @ light)
    # if exposure times are proportional to the light, dark charge cannot be distinguished from light
    return after if np.ptp(times) > 0 and float(apart.std()) > 0.05 * float(after.std()) else np.zeros(times.size)


def _scatter(light: Array, signal: Array, statistical: Array) -> float:
    """Return the relative scatter of the means about a smooth response, without sampling errors. It is estimated from
    neighbouring levels.
    """
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
    # the median of thirty levels is uncertain by a fifth; a smaller excess is not significant
    return math.sqrt(max(float(own) ** 2 - usual**2, 0.0)) if own > 1.4 * usual else 0.0


@dataclass(frozen=True)
class _Problem:
    light: Array
    signal: Array
    variance: Array
    dark: Array
    errors: tuple[Array, Array]
    full: float
    charge: Array  # DN, dark charge at each level
    usual: float  # DN, the dark charge at which ``dark`` was measured
    after: Array  # s, from `_after`; all 0: dark charge is known, or cannot be derived
    sound: Array  # levels whose means agree with their light
    hidden: bool  # the noise of dark frames is clipped or lost in rounding

    def residuals(self, fit: ResponseFit) -> tuple[Array, Array]:
        """Return the residuals of the means, and of the variances at the measured means, each divided by its standard
        error.
        """
        return (
            ((fit.mean(self.light, self.charge, self.after) - self.signal) / self.errors[0])[self.sound],
            (self.expected(fit) - self.variance) / self.errors[1],
        )

    def expected(self, fit: ResponseFit) -> Array:
        """Return the expected temporal variances of the levels, DN^2."""
        return fit.variance_at(self.signal, self.dark - fit.gain * self.usual, self.charge)

    def flexible(self, loss: str = "linear") -> ResponseFit:
        """Return the best fit with all additional parameters, over all orders of the bend."""
        return min((self.fitted(one, self.extras, loss) for one in (0.0, *ORDERS)), key=lambda one: one[1])[0]

    @property
    def extras(self) -> tuple[str, ...]:
        """Names of the additional parameters that can be fitted to these data."""
        return tuple(one for one in EXTRAS if one != "leak" or self.after.any())

    def names(self, fit: ResponseFit) -> list[str]:
        """Return the names of the parameters that were fitted."""
        found = ["gain", "rate", *(["bend"] if fit.bend else [])]
        return found + [one for one in EXTRAS if getattr(fit, one)] + (["floor"] if self.hidden else [])

    def with_sound_labels(self) -> _Problem:
        """Exclude means that differ from the fitted response by more than 8 robust standard deviations and 0.3 %."""
        # wide errors and a linear loss keep one wrong label from affecting the fit of the others
        wide = replace(self, errors=(np.hypot(self.errors[0], 1e-3 * self.signal), self.errors[1]))
        found, sound = wide.flexible("soft_l1"), self.sound
        for _ in range(3):
            away = (self.signal - found.mean(self.light, self.charge, self.after)) / self.signal
            bright = self.signal > 0.05 * self.signal.max()
            usual = 1.4826 * float(np.median(np.abs(away[bright])))
            before, sound = sound, ~bright | (np.abs(away) < max(8 * usual, 3e-3))
            if (sound == before).all() or np.count_nonzero(sound) < 4:
                return replace(self, sound=before)
            found = replace(wide, sound=sound).flexible("soft_l1")
        return replace(self, sound=sound)

    def with_own_scatter(self, fit: ResponseFit | None = None) -> _Problem:
        """Increase the errors of means and variances until they match the actual scatter about a fit. The added error
        is the same fraction of the value at every level.
        """
        fit = fit or self.flexible()
        variances = (self.variance - self.expected(fit)) / self.variance
        means = ((self.signal - fit.mean(self.light, self.charge, self.after)) / self.signal)[self.sound]
        own = (self.errors[0] / self.signal)[self.sound], self.errors[1] / self.variance
        extra = _extra(means, own[0], means.size - 3), _extra(variances, own[1], variances.size - 3)
        return replace(
            self,
            errors=(
                np.hypot(self.errors[0], extra[0] * self.signal),
                np.hypot(self.errors[1], extra[1] * self.variance),
            ),
        )

    def lack(self, fit: ResponseFit) -> tuple[float, float]:
        count = len(self.names(fit)) - 1
        means, variances = self.residuals(fit)
        return (
            math.sqrt(float((means**2).sum()) / max(means.size - count, 1)),
            math.sqrt(float((variances**2).sum()) / max(variances.size - 1, 1)),
        )

    def model(self, values: Array, order: float, names: list[str]) -> ResponseFit:
        known: dict[str, Any] = {"bend": 0.0} | {name: float(value) for name, value in zip(names, values, strict=True)}
        return ResponseFit(order=order or 1.0, full=self.full, brightest=float(self.light.max()), **known)

    def fitted(self, order: float, extras: tuple[str, ...], loss: str = "linear") -> tuple[ResponseFit, float]:
        """Return the least-squares model with these parameters, and its sum of squared residuals."""
        rate = float((self.signal * self.light).sum() / (self.light**2).sum())
        gain = float(np.median((self.variance - self.dark) / self.signal))
        most = 0.95 / (order + 1) if order else 0.0
        known = {"gain": (gain, abs(gain), 0.0, np.inf), "rate": (rate, abs(rate), 0.0, np.inf)}
        known |= {"bend": (0.01, 0.01, -most, most)} if order else {}
        known |= {one: (0.0, EXTRAS[one][1], -0.5 if one == "lamp" else -np.inf, np.inf) for one in extras}
        known |= {"floor": (0.1, 0.1, 0.0, np.inf)} if self.hidden else {}
        start, scale, lower, upper = (list(one) for one in zip(*known.values(), strict=True))
        with np.errstate(all="ignore"):  # trial steps may overflow
            found = scipy.optimize.least_squares(
                lambda v: np.concatenate(self.residuals(self.model(v, order, list(known)))),
                start, x_scale=scale, bounds=(lower, upper), loss=loss, xtol=1e-14, ftol=1e-14, gtol=1e-14,
            )  # fmt: skip
        return self.model(found.x, order, list(known)), 2 * float(found.cost)

    def chosen(self) -> tuple[ResponseFit, list[str], list[ResponseFit]]:
        """Start from constant gain and add every parameter that an F test accepts: a bend of one of three orders, and
        `EXTRAS`.

        Also return the tests as text, and the other models that the data do not exclude: a bend of another order, or
        light that is not proportional to its labels.
        """
        share, tests = LEVEL / (len(ORDERS) + len(self.extras)), list[str]()
        # Test the bend together with parameters that resemble one, except the lamp, which can be tested only once the
        # bend is known.
        extras = tuple(one for one in self.extras if one != "lamp")
        order = self._bend(extras, share, tests)
        order, kept = self._kept(order, extras, share, tests)
        # if means and variances require different bends, the light is not proportional to its labels
        with_ = {one: self.fitted(one, (*kept, "lamp")) for one in (0.0, *ORDERS)}
        best = min(with_, key=lambda one: with_[one][1])
        fit, cost = self.fitted(order, kept)
        p = _p_value(cost, with_[best][1], self._freedom(best, (*kept, "lamp")))
        tests.append(f"{EXTRAS['lamp'][0]}: p = {p:.2g}, accepted below {share:.2g}")
        others = [with_[best][0]] if share <= p < DOUBT else []
        if p < share:
            order = self._bend((*extras, "lamp"), share, tests)
            order, kept = self._kept(order, (*extras, "lamp"), share, tests, ("lamp",))
            fit, cost = self.fitted(order, kept)
        if order:
            nearly = cost * (1 + float(scipy.special.chdtri(1, DOUBT)) / self._freedom(order, kept))
            bends = [self.fitted(one, kept) for one in ORDERS if one != order]
            others += [one for one, own in bends if own < nearly and one.bend > 0]
        return fit, tests, others

    def _freedom(self, order: float, extras: tuple[str, ...]) -> int:
        return 2 * self.light.size - 2 - bool(order) - len(extras) - self.hidden

    def _bend(self, extras: tuple[str, ...], share: float, tests: list[str]) -> float:
        """Return the order of the bend that an F test accepts; 0 for none."""
        bends = {one: self.fitted(one, extras) for one in ORDERS}
        likely = min((one for one in ORDERS if bends[one][0].bend > 0), key=lambda one: bends[one][1], default=0.0)
        if not likely:
            tests.append("no bend of order 1, 2 or 3 lowers the response: constant gain")
            return 0.0
        p = _p_value(self.fitted(0.0, extras)[1], bends[likely][1], self._freedom(likely, extras))
        tests.append(f"a bend of order {likely:g} against constant gain: p = {p:.2g}, accepted below {share:.2g}")
        return likely if p < share else 0.0

    def _kept(
        self, order: float, extras: tuple[str, ...], share: float, tests: list[str], sure: tuple[str, ...] = ()
    ) -> tuple[float, tuple[str, ...]]:
        """Return the ``extras`` without which the fit is significantly worse, and the order of the bend that fits best
        with them. An order that needs fewer extras is preferred.
        """
        kept = extras
        for one in extras:
            if one in sure:
                continue
            fewer = tuple(own for own in kept if own != one)
            costs = {own: self.fitted(own, fewer) for own in (ORDERS if order else (0.0,))}
            simple = min(
                (own for own in costs if costs[own][0].bend >= 0), key=lambda own: costs[own][1], default=order
            )
            p = _p_value(costs[simple][1], self.fitted(order, kept)[1], self._freedom(order, kept))
            tests.append(f"{EXTRAS[one][0]}: p = {p:.2g}, accepted below {share:.2g}")
            if p >= share:
                order, kept = simple, fewer
        return order, kept

    def without_parts(self, fit: ResponseFit) -> Array:
        """Return standard errors from fits that omit one quarter of the levels at a time, in order of light (a block
        jackknife).
        """
        order, names, found = fit.order if fit.bend else 0.0, self.names(fit), []
        for left in np.array_split(np.arange(self.light.size), PARTS):
            keep = np.setdiff1d(np.arange(self.light.size), left)
            rest = replace(
                self, light=self.light[keep], signal=self.signal[keep], variance=self.variance[keep],
                dark=self.dark[keep], charge=self.charge[keep], after=self.after[keep], sound=self.sound[keep],
                errors=(self.errors[0][keep], self.errors[1][keep]),
            )  # fmt: skip
            one, _ = rest.fitted(order, tuple(one for one in EXTRAS if one in names))
            # the excess of the lamp refers to the brightest light, which differs between these fits
            one = replace(one, lamp=one.lamp * fit.brightest / one.brightest)
            found.append([getattr(one, name) for name in names])
        values = np.array(found)
        return np.asarray(np.sqrt((PARTS - 1) / PARTS * ((values - values.mean(0)) ** 2).sum(0)))

    def covariance(self, fit: ResponseFit, lack: tuple[float, float]) -> Array:
        """Return the covariance of the parameters. The errors of means are scaled up by the lack of fit of the means,
        those of variances by the lack of fit of the variances.
        """
        names = self.names(fit)
        values = [getattr(fit, name) for name in names]
        order = fit.order if fit.bend else 0.0

        def at(v: list[float]) -> Array:
            parts = self.residuals(self.model(np.array(v), order, names))
            return np.concatenate([one / max(own, 1.0) for one, own in zip(parts, lack, strict=True)])

        columns = []
        for i, value in enumerate(values):
            step = 1e-5 * max(abs(value), 1e-6)
            ends = [at([v + sign * step * (j == i) for j, v in enumerate(values)]) for sign in (1, -1)]
            columns.append((ends[0] - ends[1]) / (2 * step))
        design = np.stack(columns, 1)
        return np.asarray(np.linalg.pinv(design.T @ design, rcond=1e-15, hermitian=True))


def _extra(away: Array, own: Array, freedom: int) -> float:
    """Return the rms scatter that must be added to the known errors to explain the residuals; 0 if a chi-squared test
    at 1 % accepts the known errors.
    """
    freedom = max(freedom, 1)
    if float((away**2 / own**2).sum()) <= float(scipy.special.chdtri(freedom, LEVEL)):
        return 0.0
    most = 10 * math.sqrt(float((away**2).sum()) / freedom) + 1e-9
    return float(
        scipy.optimize.brentq(lambda t: float((away**2 / (own**2 + t**2)).sum()) - freedom, 0, most, xtol=1e-12)
    )


def _p_random(residuals: Array) -> float:
    """Return the p value for independence of successive residuals (von Neumann's ratio, one-sided)."""
    n = residuals.size
    if n < 6:
        return 1.0
    away = residuals - residuals.mean()
    ratio = float((np.diff(residuals) ** 2).sum() / (away**2).sum())
    return float(scipy.special.ndtr((ratio - 2) / math.sqrt(4 * (n - 2) / (n * n - 1))))


def _p_value(without: float, with_: float, freedom: int) -> float:
    """Return the p value of an F test for one more parameter."""
    if freedom < 1 or with_ <= 0:
        return 1.0
    return float(scipy.special.fdtrc(1, freedom, max(without - with_, 0.0) / (with_ / freedom)))
