"""Illumination over the field: vignetting at a rim, chief-ray angles, and tables.

In:  image heights (mm), radii and distances of rims (mm), angles (degrees or their tangents).
Out: relative illumination (1) and chief-ray angles (degrees).
Sources: plane geometry; conjugates of the pupils of a lens in air.

`radiometry.cos4` and `radiometry.disc_falloff` give the falloff of an unobstructed pupil; the factors here multiply it.
"""

import numpy as np

from etendue import require
from etendue_camera.arrays import FloatArray, Floats


def overlap_of_discs(radius: float, rim: float, shift: Floats) -> Floats:
    """Return the fraction of a disc that another disc covers.

    Parameters
    ----------
    radius, rim : float
        Radii of the disc and of the disc that covers it, same unit, above 0; ``rim`` may be infinite.
    shift : (...) array, same unit
        Distance between the centres; the sign does not matter.

    Returns
    -------
    (...) array, 1
        In [0, 1]: exactly 1 where the disc lies inside the rim, exactly 0 where it lies outside.

    Raises
    ------
    ValueError
        For a radius that is not above 0.

    Notes
    -----
    Source: the overlap is two circular segments of area a^2 (u - sin u)/2; their angles u follow from the half-angle
    formula of the triangle a, R, s: tan^2(u/4) = (R - s + a)(R + s - a)/((s + a - R)(s + a + R)). The usual form with
    arc cosines loses half the digits where the circles nearly touch, and u - sin u is computed as a series where its
    terms would cancel.
    Error: below 3e-16 relative in addition to the sensitivity to the arguments, which is large where the circles touch
    (2000 random cases, rims of 1e-3 to 1e6 times the radius, against 50 digits).
    """
    require.finite("radius", radius)
    require.positive("rim", rim)
    away = np.abs(np.asarray(shift))
    if np.isinf(rim):
        return np.ones_like(away, dtype=np.result_type(away, np.float32))[()]
    small, large = min(radius, rim), max(radius, rim)
    # tangents of a quarter of the two segment angles, from sums that lose no digits
    gap, both = large - small, large + small
    inner, outer = np.maximum(gap, away) - gap, np.maximum(both - away, 0.0)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        # gap + away rather than away + large - small, which would lose a shift far below the radii
        by_small = 2.0 * np.arctan(np.sqrt(outer * (gap + away) / (inner * (away + both))))
        by_large = 2.0 * np.arctan(np.sqrt(outer * inner / ((gap + away) * (away + both))))
        area = small**2 * segment_area(by_small) + large**2 * segment_area(by_large)
    whole = np.pi * small**2
    area = np.where(inner <= 0.0, whole, np.where(outer <= 0.0, 0.0, np.minimum(area, whole)))
    return (area / (np.pi * radius**2))[()]


def vignetting(
    tan_angle: Floats,
    pupil_radius: float,
    rim_radius: float,
    rim_distance: float,
    object_distance: float = float("inf"),
) -> Floats:
    """Return the fraction of the entrance pupil that a round rim in front of it leaves open.

    Parameters
    ----------
    tan_angle : (...) array, 1
        Tangent of the object-side field angle at the centre of the entrance pupil.
    pupil_radius, rim_radius : float, mm
        Above 0. The rim must pass the full beam of an axial point; otherwise it would be the aperture stop.
    rim_distance : float, mm
        From the entrance pupil, 0 or above.
    object_distance : float, mm
        From the entrance pupil, beyond the rim; inf for an object at infinity.

    Returns
    -------
    (...) array, 1
        1 on the axis and as far out as the rim does not cut the beam, then decreasing to 0.

    Raises
    ------
    ValueError
        For lengths outside these ranges, or a rim that cuts the light of an axial point.

    Notes
    -----
    Source: seen from the object point, the rim casts a shadow of radius k R on the pupil plane, displaced by k d
    tan(theta), with k = 1/(1 - d/L). Multiplied by `radiometry.cos4` this is exact for a small pupil. The different
    weights of the parts of a wide pupil are neglected; the relative error is at most the error of `radiometry.cos4`
    relative to `radiometry.disc_falloff`.
    """
    require.must(rim_distance >= 0, "rim_distance", rim_distance, "0 or above")
    require.that(
        object_distance > rim_distance,
        f"object_distance is {object_distance} mm; it must be beyond the rim, {rim_distance} mm",
    )
    wider = 1.0 / (1.0 - rim_distance / object_distance)
    shadow = wider * rim_radius
    if shadow < pupil_radius:
        raise ValueError(
            f"rim_radius is {rim_radius:g} mm, but the beam of an axial point is {pupil_radius / wider:g} mm in radius "
            f"there: the rim would be the aperture stop; increase rim_radius, or give the f-number that the rim allows"
        )
    return overlap_of_discs(pupil_radius, shadow, wider * rim_distance * np.asarray(tan_angle))


def chief_ray_angle(height_mm: Floats, exit_pupil_distance_mm: float) -> Floats:
    """Return the angle (degrees) at which the ray through the centre of the exit pupil meets the sensor.

    Parameters
    ----------
    height_mm : (...) array, mm
        Distance from the axis.
    exit_pupil_distance_mm : float, mm
        Distance in front of the sensor; inf for a telecentric lens; negative for a pupil behind the sensor, with
        converging rays.

    Raises
    ------
    ValueError
        For a distance of 0 or NaN.
    """
    require.that(abs(exit_pupil_distance_mm) > 0, f"exit_pupil_distance is {exit_pupil_distance_mm}; it must not be 0")
    return np.degrees(np.arctan(np.asarray(height_mm) / exit_pupil_distance_mm))


def cosine_response(angle_deg: Floats, power: float) -> Floats:
    """Return the relative response of a pixel to light from an angle, cos^power; 0 from 90 degrees on.

    Parameters
    ----------
    angle_deg : (...) array, degrees
        Angle from the design direction of the pixel.
    power : float, 1
        0 or above; 0: no dependence. 1 is the projected area of a flat detector.
    """
    require.must(power >= 0, "power", power, "0 or above")
    cosine = np.cos(np.radians(np.minimum(np.abs(angle_deg), 90.0)))
    return np.maximum(cosine, 0.0) ** power


def table_at(where: Floats, nodes: FloatArray, values: FloatArray) -> Floats:
    """Interpolate a table linearly between its rows; beyond the rows its end values apply.

    Parameters
    ----------
    where : (...) array
    nodes : (n,) array
        Ascending.
    values : (n,) array

    Returns
    -------
    (...) array
        Exactly the values of the table at its nodes; in the precision of ``where``.
    """
    where = np.asarray(where)
    return np.interp(where, nodes, values).astype(np.result_type(where, np.float32), copy=False)


def segment_area(half_angle: Floats) -> Floats:
    """Return (u - sin u)/2 for u = 2 x half_angle: the area of a segment of a unit circle."""
    u = 2.0 * np.asarray(half_angle)
    squared = u * u
    series: Floats = 0.0
    # u^3/6 (1 - u^2/20 (1 - u^2/42 (...))); omitted terms are below 1e-17 for u < 1.2
    for k in (17, 15, 13, 11, 9, 7, 5):
        series = squared / ((k - 1) * k) * (1.0 - series)
    return 0.5 * np.where(u < 1.2, u * squared / 6.0 * (1.0 - series), u - np.sin(u))
