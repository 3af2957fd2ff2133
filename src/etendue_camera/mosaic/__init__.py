"""Raw pictures: shading, defects, white balance, and planes out of a mosaic.

In:  a mosaic and the colour of its pixels.
Out: the mosaic corrected, or full planes.
"""
