"""Scenes: charts, photographs and cubes as spectral radiance on the grid of the image plane.

In:  parameters of a pattern, a picture or a cube.
Out: shapes in cells of a grid, ready to be given spectra.
"""
