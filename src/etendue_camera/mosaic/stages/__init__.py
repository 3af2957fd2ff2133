"""Raw pictures: shading, defects, white balance, and planes out of a mosaic.

In:  ``mosaic_linear``.
Out: ``mosaic_linear`` corrected, ``rgb_camera`` of full planes, the white of the camera.
"""
