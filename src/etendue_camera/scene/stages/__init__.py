"""Light's beginning: charts, photographs and cubes as spectral radiance on the grid of the image plane.

In:  a chart, a photograph or a cube, and the light on it.
Out: ``radiance`` and ``white_radiance``, and what is known of them before anything runs.
"""
