"""Field-dependent effects: falloff, vignetting, distortion, point spread functions.

In:  ``irradiance``.
Out: ``irradiance`` with these effects applied.
"""
