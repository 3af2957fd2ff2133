"""Light's beginning: charts, photographs and cubes as spectral radiance on the grid of the image plane.

In:  nothing but a pattern, a picture or a cube.
Out: shapes in cells of a grid, ready to be given spectra.
"""
