"""Colour: camera primaries to XYZ, white, the display and its encoding; differences between colours.

In:  ``rgb_camera``.
Out: ``xyz``, ``rgb_linear``, ``rgb_display``.
"""
