"""Charts of many patches, as weights that a scene multiplies by spectra, and one chart that combines them all.

In:  positions y (ny,) and x (nx,) on the image plane (um, 0 in the centre), geometry (um), reflectances.
Out: coverage of each patch (0 to 1), either as full planes or as one factor along y and one along x;
     grey reflectance (ny, nx); dimensionless, in the dtype of y and x.
Sources: X-Rite ColorChecker Classic (4 x 6 patches), ISO 12233 (tilted square); Gaussian softening in closed
form.

Coverages and grey add up to at most 1 everywhere, so spectra within [0, 1] give a scene within [0, 1].
Charts are rendered as specified by a ``Rendering``, see ``charts``.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from etendue import require
from etendue_camera.arrays import FloatArray
from etendue_camera.scene.cell_means import closely, half_plane_mean
from etendue_camera.scene.charts import (
    Rendering,
    require_axes,
    require_positive,
    siemens_star,
    soft_box,
    step_wedge,
    zone_plate,
)

PATCH_ROWS, PATCH_COLUMNS = 4, 6
FILL = 0.9  # fraction of its region that a panel fills; the rest is grey and separates panels
GAP = 0.1  # between patches, as a fraction of the smaller patch pitch
OUTER_SQUARE, INNER_SQUARE = 0.8, 0.4  # sides of the tilted squares, as fractions of the panel
EDGE_REACH, EDGE_LENGTH = 0.3, 0.26  # window around an edge, across and along it, as fractions of the panel
TAIL = 9.0  # rms widths beyond which a soft border is 0 in float64


class Region(NamedTuple):
    """A rectangle on the image plane, um."""

    top: float
    bottom: float
    left: float
    right: float


class PatchGrid(NamedTuple):
    """Rectangular patches side by side.

    ``width`` and ``height``, um, above 0, are the size of the whole grid, between the outer borders of the first and
    the last patch. ``gap``, um, is the distance between neighbours in both directions; it must leave room for patches.
    """

    rows: int  # above 0
    columns: int
    width: float
    height: float
    gap: float


class Panels(NamedTuple):
    """The panels of the composite chart besides its patches."""

    highest_frequency: float  # cycles/um, above 0: of the zone plate, at its rim
    angle_deg: float = 5.0  # -10 to 10: of the squares, a dark one inside a light one, for the slanted-edge method
    cycles: int = 36  # of the star, above 0
    steps: int = 8  # of the wedge, above 1, evenly spaced from low to high


class Composite(NamedTuple):
    """The composite chart: grey reflectance, and the factors of its 24 patches.

    A scene is ``grey * white[:, None, None] + patch_contribution(rows, columns, spectra)``.
    """

    grey: FloatArray  # (ny, nx), reflectance; excludes the area that patches cover
    rows: FloatArray  # (4, ny)
    columns: FloatArray  # (6, nx)


# ------------------------------------------------------------------------------------------------ patches


def patches_factors(
    y: npt.ArrayLike, x: npt.ArrayLike, grid: PatchGrid, drawn: Rendering
) -> tuple[FloatArray, FloatArray]:
    """Return the coverage of a grid of rectangular patches, as factors along y and x.

    Parameters
    ----------
    y, x : (ny,), (nx,) arrays, um
    grid : PatchGrid
    drawn : Rendering

    Returns
    -------
    rows_profile : (rows, ny) array, 0 to 1; the first row at the smallest y
    columns_profile : (columns, nx) array, 0 to 1

    Raises
    ------
    ValueError
        If an argument is outside its range.

    Notes
    -----
    Exact: patch (i, j) covers rows_profile[i] (x) columns_profile[j], a soft rectangle.
    """
    y, x = require_axes(y, x)
    require_positive(width=grid.width, height=grid.height)
    return (
        _profile(y, "rows", grid.rows, "height", grid.height, grid.gap, drawn),
        _profile(x, "columns", grid.columns, "width", grid.width, grid.gap, drawn),
    )


def _profile(
    position: FloatArray, what: str, count: int, along: str, length: float, gap: float, drawn: Rendering
) -> FloatArray:
    require.that(count == int(count) and count >= 1, f"{what} must be a whole number above 0, got {count}")
    count = int(count)
    size = (length - (count - 1) * gap) / count
    if not (gap >= 0 and size > 0):
        room = f"leave room for {count} {what} in {along}={length} um"
        raise ValueError(f"gap must be at least 0 and {room}, got {gap}")
    starts = [-0.5 * length + index * (size + gap) for index in range(count)]
    return np.stack([soft_box(position, start, start + size, drawn.softness, drawn.cell) for start in starts])


def patches(y: npt.ArrayLike, x: npt.ArrayLike, grid: PatchGrid, drawn: Rendering) -> FloatArray:
    """Return the coverage of a grid of rectangular patches, one plane per patch.

    Parameters and errors are the same as for ``patches_factors``.

    Returns
    -------
    (rows * columns, ny, nx) array, 0 to 1
        Row by row from the smallest y and x. The sum over patches is at most 1; ``background_weight`` is the
        remainder.
    """
    rows_profile, columns_profile = patches_factors(y, x, grid, drawn)
    planes = rows_profile[:, None, :, None] * columns_profile[None, :, None, :]
    return planes.reshape(-1, *planes.shape[2:])


def background_weight(rows_profile: FloatArray, columns_profile: FloatArray) -> FloatArray:
    """Return the fraction that no patch covers, (ny, nx), 0 to 1, from the factors of ``patches_factors``."""
    covered = rows_profile.sum(axis=0)[:, None] * columns_profile.sum(axis=0)
    return np.clip(1 - covered, 0, 1)


def patch_contribution(rows_profile: FloatArray, columns_profile: FloatArray, spectra: npt.ArrayLike) -> FloatArray:
    """Return the sum over patches of coverage times spectrum.

    Parameters
    ----------
    rows_profile : (rows, ny) array
    columns_profile : (columns, nx) array
    spectra : (rows * columns, n) array, any unit
        Row by row, as in ``patches``.

    Returns
    -------
    (n, ny, nx) array, the unit of ``spectra``

    Raises
    ------
    ValueError
        If the numbers of spectra and patches differ.

    Notes
    -----
    Two matrix products; the (rows * columns, ny, nx) planes are never created.
    """
    rows, columns = len(rows_profile), len(columns_profile)
    table = np.asarray(spectra, dtype=np.result_type(rows_profile, columns_profile))
    if table.ndim != 2 or len(table) != rows * columns:
        raise ValueError(f"spectra must have shape ({rows * columns}, n), got {table.shape}")
    # contiguous: for strided arrays, the sum depends on n before numpy 2.3
    along_x = np.ascontiguousarray(table.T).reshape(-1, rows, columns) @ columns_profile
    return rows_profile.T @ along_x


# ---------------------------------------------------------------------------------------------- composite


def composite_regions(width: float, height: float) -> dict[str, Region]:
    """Return the position of each part of the composite chart.

    Parameters
    ----------
    width, height : float, um, above 0
        Size of the whole chart.

    Returns
    -------
    dict of Region
        "patches" (left third), "squares" above "star" (centre), "zone_plate" above "wedge" (right), where above
        means smaller y; and, inside "squares", the windows "edge_vertical" and "edge_horizontal", each
        with one straight edge and nothing else.
    """
    require_positive(width=width, height=height)
    third, half = width / 3, height / 2
    panel = min(third, half)
    side = FILL * panel
    edge = 0.5 * INNER_SQUARE * panel
    reach, length = EDGE_REACH * panel, EDGE_LENGTH * panel
    return {
        "patches": _region(0.0, -third, FILL * height, FILL * third),
        "squares": _region(-0.5 * half, 0.0, side, side),
        "star": _region(0.5 * half, 0.0, side, side),
        "zone_plate": _region(-0.5 * half, third, side, side),
        "wedge": _region(0.5 * half, third, FILL * half, FILL * third),
        "edge_vertical": _region(-0.5 * half, -edge, length, reach),
        "edge_horizontal": _region(-0.5 * half - edge, 0.0, reach, length),
    }


def _region(y: float, x: float, height: float, width: float) -> Region:
    return Region(y - 0.5 * height, y + 0.5 * height, x - 0.5 * width, x + 0.5 * width)


def composite(
    y: npt.ArrayLike,
    x: npt.ArrayLike,
    width: float,
    height: float,
    drawn: Rendering,
    panels: Panels,
) -> Composite:
    """Return colour patches, slanted edges, star, zone plate and grey steps in one frame.

    Parameters
    ----------
    y, x : (ny,), (nx,) arrays, um
    width, height : float, um, above 0
        Size of the whole chart; ``composite_regions`` gives its parts. Outside, the chart is (low + high) / 2.
    drawn : Rendering
        Its high is at most 1.
    panels : Panels

    Returns
    -------
    Composite

    Raises
    ------
    ValueError
        If an argument is outside its range.

    Notes
    -----
    All panels lie on one grey, which is the mean of each, so there are no seams between regions; all borders have the
    softness of the rendering. Squares, wedge and patches are exact convolutions, including corners, as long as panels
    are many softnesses apart (their distance is a tenth of a panel). Star and zone plate are local approximations, see
    ``charts``. Means over cells are exact, except at the corners of the tilted squares (error below 0.01 in eight cells
    for hard borders) and in the star and the zone plate, which are quadratures.
    """
    y, x = require_axes(y, x)
    low, high = drawn.low, drawn.high
    highest_frequency, angle_deg, cycles, steps = panels
    require.that(not high > 1, f"high must be at most 1, got {high}")
    require.that(-10 <= angle_deg <= 10, f"angle_deg must lie between -10 and 10 degrees, got {angle_deg}")
    require.that(steps == int(steps) and steps >= 2, f"steps must be a whole number above 1, got {steps}")
    width, height = float(width), float(height)
    regions = composite_regions(width, height)
    panel = min(width / 3, height / 2)
    radius, wedge = 0.5 * FILL * panel, regions["wedge"]
    levels = np.linspace(low, high, int(steps))
    painters: dict[str, Callable[[FloatArray, FloatArray], FloatArray]] = {
        "squares": lambda v, u: _tilted_squares(v, u, panel, angle_deg, drawn),
        "star": lambda v, u: siemens_star(v, u, cycles, radius, drawn),
        "zone_plate": lambda v, u: zone_plate(v, u, highest_frequency, radius, drawn),
        "wedge": lambda v, u: step_wedge(v, u, levels, wedge.right - wedge.left, wedge.bottom - wedge.top, drawn),
    }
    # A tilted corner leaves its region by less than 0.02 of the panel; the tenth between panels has room for it.
    reach = TAIL * float(drawn.softness) + 0.05 * panel + float(drawn.cell)
    background = 0.5 * (float(low) + float(high))  # also around each panel, which adds nothing outside its borders
    grey = np.full((y.size, x.size), background, dtype=x.dtype)
    for name, paint in painters.items():
        top, bottom, left, right = regions[name]
        inside_y, inside_x = _within(y, top, bottom, reach), _within(x, left, right, reach)
        if inside_y.size and inside_x.size:
            y_centre, x_centre = _centre(regions[name])
            grey[np.ix_(inside_y, inside_x)] += paint(y[inside_y] - y_centre, x[inside_x] - x_centre) - background
    rows, columns = _patch_profiles(y, x, regions["patches"], drawn)
    return Composite(np.clip(grey, float(low), float(high)) * background_weight(rows, columns), rows, columns)


def _within(position: FloatArray, start: float, stop: float, reach: float) -> npt.NDArray[np.intp]:
    return np.flatnonzero((position >= start - reach) & (position <= stop + reach))


def _centre(region: Region) -> tuple[float, float]:
    return 0.5 * (region.top + region.bottom), 0.5 * (region.left + region.right)


def _tilted_squares(y: FloatArray, x: FloatArray, panel: float, angle_deg: float, drawn: Rendering) -> FloatArray:
    """Return the reflectance of a dark square inside a light square on grey, both tilted by the same angle. The
    softening Gaussian is isotropic, so a softened square is the product of two profiles, each across one pair of its
    sides.
    """
    angle = np.deg2rad(float(angle_deg))
    outer, inner = (
        _square(y, x, angle, side * panel, drawn.softness, drawn.cell) for side in (OUTER_SQUARE, INNER_SQUARE)
    )
    return drawn.blend(0.5 + 0.5 * outer - inner)


def _square(y: FloatArray, x: FloatArray, angle: float, side: float, softness: float, cell: float) -> FloatArray:
    half = 0.5 * side
    cosine, sine = float(np.cos(angle)), float(np.sin(angle))

    def at(v: FloatArray, u: FloatArray) -> FloatArray:
        across, along = u * cosine - v * sine, v * cosine + u * sine
        return soft_box(across, -half, half, softness) * soft_box(along, -half, half, softness)

    v, u = y[:, None], x[None, :]
    if cell == 0:
        return at(v, u)

    def strip(position: FloatArray) -> FloatArray:
        covered = half_plane_mean(position + half, angle, softness, cell) - half_plane_mean(
            position - half, angle, softness, cell
        )
        return np.clip(covered, 0, 1)

    across, along = strip(u * cosine - v * sine), strip(v * cosine + u * sine)
    covered = across * along
    # the mean of the product is the product of the means, except where borders of both strips meet in a cell
    rows, columns = np.nonzero((across > 0) & (across < 1) & (along > 0) & (along < 1))
    if rows.size:
        covered[rows, columns] = closely(at, y[rows], x[columns], cell)
    return covered


def _patch_profiles(y: FloatArray, x: FloatArray, region: Region, drawn: Rendering) -> tuple[FloatArray, FloatArray]:
    width, height = region.right - region.left, region.bottom - region.top
    gap = GAP * min(width / PATCH_COLUMNS, height / PATCH_ROWS)
    y_centre, x_centre = _centre(region)
    return patches_factors(y - y_centre, x - x_centre, PatchGrid(PATCH_ROWS, PATCH_COLUMNS, width, height, gap), drawn)
