"""Raw processing: shading, defects, white balance, demosaicing.

In:  a mosaic and the colour of its pixels.
Out: the mosaic corrected, or full planes.
"""
