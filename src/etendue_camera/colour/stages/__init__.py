"""Colour: camera RGB to XYZ, white, display and encoding; colour differences.

In:  ``rgb_camera``.
Out: ``xyz``, ``rgb_linear``, ``rgb_display``.
"""
