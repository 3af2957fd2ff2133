"""Scenes: charts, photographs and cubes as spectral radiance on the image-plane grid.

In:  a chart, a photograph or a cube, and the light on it.
Out: ``radiance`` and ``white_radiance``, and their known properties before a run.
"""
