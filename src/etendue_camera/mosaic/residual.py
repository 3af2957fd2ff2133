"""Demosaicing with two estimators of green, one for fine grey detail and one for saturated edges; red and blue follow
green by local slopes.

In:  Bayer mosaic (y, x), linear, in any unit; its pattern.
Out: planes (3, y, x) of red, green, blue in the same unit; measured samples are unchanged.

In every row and column two colours alternate. Let m be the sample and o the mean of its two neighbours, which have the
other colour. Both estimators give D = green - other at all samples, along rows and along columns:

*Smooth.* The missing colour is o plus a quarter of m's second difference (Hamilton and Adams, US patent 5629734). Along
the line D is a slow signal plus the noise of that estimate. The linear minimum-mean-square-error estimate of D and its
error are computed from the local variances of signal and noise; rows and columns are weighted by their inverse errors
(L. Zhang and X. Wu, "Color demosaicking via directional linear minimum mean square-error estimation", 2005). Across an
edge, the mean of nine samples can differ from all of them. Therefore (our addition) D is clipped to the minimum and
maximum of the 3 x 3 estimates around it, and its assumed error is at most half that range. This estimator is best where
the colours share their detail.

*Sharp.* Residual interpolation: m is predicted from o by a guided filter, and the residual of the prediction is
interpolated (D. Kiku, Y. Monno, M. Tanaka and M. Okutomi, "Residual interpolation for color image demosaicking", 2013).
Here only the slope of the guided filter is used: a = cov(m, o) / var(o), after subtracting the 3 x 3 means from m and
o, averaged over windows. The missing colour is a m + the mean of the neighbours' (m - a o); the filter's offset
cancels. The four half-lines from a pixel are weighted by 1 / (sum of |change of D| around their first sample)^2 (after
I. Pekkucuksen and Y. Altunbasak, "Gradient based threshold free color filter array interpolation", 2010). This
estimator is best where the colours differ in their detail.

*Mixed* (ours): sharp + (smooth - sharp) / (1 + 1e5 s^4 d). Here s is the fraction of the change of the smooth
estimator's D that survives smoothing along the line (noise does not, coloured edges do), and d is the energy of
smooth - sharp relative to the energy of the mosaic's own changes. Both s and d are ratios of sums over 9 x 9 pixels.

Red and blue: a is the slope of the colour on green over the 9 x 9 pixels around each of its samples, limited to 0 to 2
and pulled towards 1 where there is little detail. The colour is a green + the interpolated (sample - a green).

*Repeated*: once all three colours are known, o is taken from them instead of the mean of neighbours, and the sharp
estimate is repeated. The repeated estimate replaces the mixed estimate to the degree that the mixed estimate relied on
the smooth one (iterating helps where colours share their detail, and harms elsewhere: Y. Monno, D. Kiku, M. Tanaka and
M. Okutomi, "Adaptive residual interpolation for color and multispectral image demosaicking", 2017). Red and blue are
then computed from the new green.

All constants are relative to the local mean square, so the method works in any unit. A pixel depends on pixels up to
`REACH` away.
"""

import numpy as np
from numpy.typing import NDArray

from etendue_camera.mosaic.bilinear import colour_difference
from etendue_camera.mosaic.frame import BLUE, GREEN, RED, checked, in_tiles
from etendue_camera.mosaic.windows import (
    Sum,
    centre,
    extreme,
    five,
    meet,
    moved,
    nine,
    pair,
    scaled,
    slope,
    square,
    three,
    within,
)
from etendue_camera.sensor.cfa import COLOURS, phase

FIRST_REACH, SECOND_REACH, CHROMA_REACH = 18, 12, 12
REACH = FIRST_REACH + CHROMA_REACH + SECOND_REACH + CHROMA_REACH
FLOOR = 1e-4  # of the local mean square: energies well below it (1 % of the local level) carry no information
EVEN = 1e-5  # of the local mean square: rows and columns have equal weights where both errors are smaller
PULL = 4e-3  # pull of slopes on green, relative to the mean of the two colours' squared levels
CHOICE = 1e5  # smooth and sharp estimates have equal weights where s^4 d is the inverse of this
TINY = 1e-30  # of the squared peak: keeps ratios finite where everything is black


def residual(mosaic: NDArray, pattern: str) -> NDArray:
    """Estimate green by two estimators along rows and columns, mixed by local statistics; red and blue by local slopes.

    Arguments, result and errors are the same as for every method (see `frame`). Results may leave the range of the
    mosaic; negative values are kept.

    Notes
    -----
    Mean CPSNR by `benchmarks/demosaic.py`: 41.2 dB on Kodak and 36.4 dB on McMaster pictures. Channels should be
    white-balanced: otherwise the method cannot recognise detail that the colours share.

    Constant planes are exact to rounding, linear planes (each with its own slopes) to 1e-7 inside the border; grey
    detail near the sampling limit does not stay grey. Inside a dark neutral corner, colours err by 0.001 of the
    adjacent white five pixels from the edge, and by 0.0045 four pixels from it. Next to isolated samples on black,
    results reach 4 times the height of the samples. Scaling by powers of two, mirroring, shifting the window by any
    number of pixels, changing the sign, and swapping red with blue change the result accordingly, bit for bit;
    transposing does so up to rounding. Single precision is within 2e-6 of full scale on photographs, 1e-5 on the worst
    artificial mosaics of the tests. Frames of one line, which have no second direction, use
    `bilinear.colour_difference`.
    """
    mosaic = checked(mosaic, pattern)
    if 1 in mosaic.shape:
        return colour_difference(mosaic, pattern)
    places = phase(pattern)
    kind = mosaic.dtype if mosaic.dtype.itemsize > 2 else np.dtype(np.float32)
    work = mosaic.astype(kind)
    # scale by a power of two so that the largest sample is near 1, and squares neither overflow nor underflow
    peak, limit = np.max(np.abs(work), where=np.isfinite(work), initial=0.0), -np.finfo(kind).minexp
    factor = float(2.0 ** -np.clip(np.frexp(peak)[1], -limit, limit)) if peak > 0 else 1.0
    work *= kind.type(factor)

    def method(planes: NDArray, framed: NDArray) -> None:
        sign = np.full(framed.shape, -1, kind)
        for y, x in places["G"]:
            sign[y::2, x::2] = 1  # every reach is even, so an array reduced by it keeps the pattern of the frame
        _tile(planes, framed, sign, [places[COLOURS[c]][0] for c in (RED, BLUE)])

    with np.errstate(over="ignore", under="ignore", invalid="ignore"):
        planes = in_tiles(work, REACH, method)
        planes *= kind.type(1 / factor)
    planes = planes.astype(mosaic.dtype, copy=False)
    for colour, sites in places.items():
        for y, x in sites:
            planes[COLOURS.index(colour), y::2, x::2] = mosaic[y::2, x::2]
    return planes


def _tile(planes: NDArray, mosaic: NDArray, sign: NDArray, places: list[tuple[int, int]]) -> None:
    """Fill a tile. `sign` is 1 at green samples and -1 at others; `places` are the sites of red and blue in the
    cell.
    """
    level = scaled(square(np.square(mosaic), nine), 1 / 81)
    level += level.dtype.type(TINY)
    others = [scaled(pair(mosaic, axis), 0.5) for axis in (1, 0)]
    difference, trust = _mixed(mosaic, sign, level, _sharp(mosaic, others, sign, level))
    difference, mosaic, sign = within(FIRST_REACH, mosaic.shape, difference, mosaic, sign)
    green = _green(difference, mosaic, sign)
    colours = [_follow(mosaic, green, place) for place in places]
    difference, trust, mosaic, sign, green = within(CHROMA_REACH, mosaic.shape, difference, trust, mosaic, sign, green)
    again = _sharp(mosaic, _others(green, colours, places), sign, level)
    again, difference, trust, mosaic, sign = within(SECOND_REACH, mosaic.shape, again, difference, trust, mosaic, sign)
    again -= difference
    again *= trust
    again += difference
    final = _green(again, mosaic, sign)
    for colour, place in zip((RED, BLUE), places, strict=True):
        planes[colour] = _follow(mosaic, final, place)
    planes[GREEN] = centre(final, *planes.shape[1:])


def _green(difference: NDArray, mosaic: NDArray, sign: NDArray) -> NDArray:
    """Return the sample where it is green, and the sample plus (green - other) elsewhere."""
    green = 1 - sign
    green *= difference
    scaled(green, 0.5)
    green += mosaic
    return green


def _others(green: NDArray, colours: list[NDArray], places: list[tuple[int, int]]) -> list[NDArray]:
    """Return, from complete planes, the other colour of each sample's row and the other colour of its column."""
    in_row, in_column = green.copy(), green.copy()
    for plane, (row, column) in zip(colours, places, strict=True):
        in_row[row::2, 1 - column :: 2] = plane[row::2, 1 - column :: 2]
        in_column[1 - row :: 2, column::2] = plane[1 - row :: 2, column::2]
    return [in_row, in_column]


def _mixed(mosaic: NDArray, sign: NDArray, level: NDArray, sharp: NDArray) -> tuple[NDArray, NDArray]:
    """Return D mixed from both estimators, valid at red and blue samples, and the weight of the smooth estimate."""
    smooth, lasting = _smooth(mosaic, sign, level)
    sharp, smooth, own = meet(sharp, smooth, sign)
    gap = smooth - sharp
    energy = gap * gap
    energy *= 1 - own  # 2 at red and blue samples; at green ones rows and columns refer to different colours
    change = np.add(*meet(*(np.square(slope(mosaic, axis)) for axis in (0, 1))))
    energy, change, floor, lasting = meet(
        square(energy, nine), square(change, nine), scaled(level * 81, FLOOR), lasting
    )
    trust = energy + floor
    trust /= change + floor
    trust *= lasting
    trust *= trust.dtype.type(CHOICE)
    trust += 1
    np.reciprocal(trust, out=trust)
    gap, sharp, trust = meet(gap, sharp, trust)
    gap *= trust
    gap += sharp
    return gap, trust


def _smooth(mosaic: NDArray, sign: NDArray, level: NDArray) -> tuple[NDArray, NDArray]:
    """Return D by the smooth estimator, and the fourth power of the fraction of its change that survives smoothing."""
    estimates, energies = [], []
    for axis in (1, 0):
        other = scaled(pair(mosaic, axis, 2), -0.25)
        other += moved(scaled(pair(mosaic, axis), 0.5), axis, 0, 1)
        other += moved(mosaic, axis, 0, 2) * mosaic.dtype.type(0.5)
        rough = _difference(mosaic, other, sign)
        slow = scaled(five(five(rough, axis), axis), 1 / 25)
        estimates.append(_likeliest(rough, slow, axis, level))
        energies.append([square(np.square(slope(d, axis)), nine) for d in (slow, rough)])
    along_rows, error_rows, along_columns, error_columns = meet(*estimates[0], *estimates[1])
    mixed = along_rows * error_columns
    mixed += along_columns * error_rows
    mixed /= error_rows + error_columns
    slow, rough = (np.minimum(*meet(*both)) for both in zip(*energies, strict=True))
    slow, rough, floor = meet(slow, rough, scaled(level * 81, FLOOR))
    lasting = slow + floor
    lasting /= rough + floor
    lasting *= lasting
    lasting *= lasting
    return mixed, lasting


def _likeliest(rough: NDArray, slow: NDArray, axis: int, level: NDArray) -> tuple[NDArray, NDArray]:
    """Return the signal in `rough` along a line and its expected squared error; `slow` gives its mean and variance."""
    mean = scaled(nine(slow, axis), 1 / 9)
    variance = np.square(moved(slow, axis, 0, 4) - mean)  # every other sample suffices, since slow varies slowly
    for by in (2, 4):
        deviations = [np.square(moved(slow, axis, way * by, 4) - mean) for way in (1, -1)]
        variance += np.add(*deviations)
    scaled(variance, 1 / 5)
    noise = scaled(nine(np.square(np.subtract(*meet(rough, slow))), axis), 1 / 9)
    least, greatest = (extreme(rough, choose) for choose in (np.minimum, np.maximum))
    mean, variance, noise, rough, level, least, greatest = meet(mean, variance, noise, rough, level, least, greatest)
    total = variance + noise
    total += level * level.dtype.type(FLOOR)
    share = variance / total
    signal = rough - mean
    signal *= share
    signal += mean
    np.clip(signal, least, greatest, out=signal)
    error = share * noise
    greatest -= least
    greatest *= greatest
    np.minimum(error, scaled(greatest, 0.25), out=error)
    error += level * level.dtype.type(EVEN)
    return signal, error


def _sharp(mosaic: NDArray, others: list[NDArray], sign: NDArray, level: NDArray) -> NDArray:
    """Return D by the sharp estimator, weighted towards the half-lines along which it changes least.

    `others` are the other colour of each sample's row and of its column.
    """
    parts = []
    for axis, other in zip((1, 0), others, strict=True):
        difference = _difference(mosaic, _by_slope(mosaic, other, axis, level), sign)
        change = np.abs(slope(difference, axis))
        change = three(three(change, 1 - axis), axis)
        change *= change
        weight, floor = meet(change, level)
        weight += floor * floor.dtype.type(FLOOR)
        np.reciprocal(weight, out=weight)
        here = moved(difference, axis, 0, 1)
        after, before = (meet(moved(difference, axis, way, 1) + here, moved(weight, axis, way, 1)) for way in (1, -1))
        parts += [after[0] * after[1] + before[0] * before[1], after[1] + before[1]]
    rows, weight_rows, columns, weight_columns = meet(*parts)
    mean = rows + columns
    mean /= weight_rows + weight_columns
    return scaled(mean, 0.5)


def _by_slope(mosaic: NDArray, other: NDArray, axis: int, level: NDArray) -> NDArray:
    """Return the missing colour along each line: a m + the mean of the neighbours' (m - a o)."""

    def window(values: NDArray, along: Sum) -> NDArray:
        return along(three(values, 1 - axis, 2), axis, 2)

    own, other = meet(mosaic, other)
    own_part, other_part = (np.subtract(*meet(a, scaled(window(a, three), 1 / 9))) for a in (own, other))
    own_part *= other_part
    other_part *= other_part
    together, alone = window(own_part, five), window(other_part, five)
    floor = meet(level, together)[0] * level.dtype.type(15 * FLOOR)
    together += floor
    alone += floor
    together /= alone
    a = scaled(window(together, three), 1 / 9)
    own, other = meet(own, other, a)[:2]
    rest = own - a * other
    missing = pair(a, axis)
    missing *= moved(own, axis, 0, 1)
    missing += pair(rest, axis)
    return scaled(missing, 0.5)


def _difference(mosaic: NDArray, other: NDArray, sign: NDArray) -> NDArray:
    """Return green minus red or blue; ``other`` is the estimate of the colour that a sample lacks."""
    mosaic, other, sign = meet(mosaic, other, sign)
    difference = mosaic - other
    difference *= sign
    return difference


def _follow(mosaic: NDArray, green: NDArray, place: tuple[int, int]) -> NDArray:
    """Return red or blue, on an area smaller by `CHROMA_REACH` per side; `place` is its site in the cell."""
    row, column = place
    samples, guide = (np.ascontiguousarray(a[row::2, column::2]) for a in (mosaic, green))
    sample_mean, guide_mean = (scaled(square(a, three), 1 / 9) for a in (samples, guide))
    together, alone = np.subtract(*meet(samples, sample_mean)), np.subtract(*meet(guide, guide_mean))
    together *= alone
    alone *= alone
    together, alone = square(together, five), square(alone, five)
    floor, level = (np.square(meet(a, together)[0]) for a in (sample_mean, guide_mean))
    floor += level
    scaled(floor, 25 * 0.5 * PULL)
    floor += floor.dtype.type(TINY)
    together += floor
    alone += floor
    together /= alone
    np.clip(together, 0, 2, out=together)
    a = scaled(square(together, five), 1 / 25)
    samples, guide = meet(samples, guide, a)[:2]
    rest = samples - a * guide
    (inner,) = within(CHROMA_REACH, green.shape, green)
    plane = np.empty_like(inner)
    lost = 10 - CHROMA_REACH  # position of the first element of `a`, from the first sample inside
    for y in (0, 1):
        for x in (0, 1):
            target = plane[y::2, x::2]
            down, between_rows = divmod(y - row - lost, 2)
            right, between_columns = divmod(x - column - lost, 2)
            bottom, end = down + target.shape[0] + between_rows, right + target.shape[1] + between_columns
            sums = []
            for some in (a[down:bottom, right:end], rest[down:bottom, right:end]):
                some = some[1:] + some[:-1] if between_rows else some
                sums.append(some[:, 1:] + some[:, :-1] if between_columns else some)
            np.multiply(sums[0], inner[y::2, x::2], out=target)
            target += sums[1]
            target *= target.dtype.type(1 / (1 + between_rows) / (1 + between_columns))
    return plane
