"""Raw processing: shading, defects, white balance, demosaicing.

In:  ``mosaic_linear``.
Out: ``mosaic_linear`` corrected, full planes ``rgb_camera``, the camera white.
"""
