"""What changes over the frame: fall-off, vignetting, distortion, point spread functions by field.

In:  ``irradiance``.
Out: ``irradiance``, each place with what the lens does there.
"""
