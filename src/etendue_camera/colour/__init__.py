"""Colour: camera primaries to XYZ, white, the display and its encoding; differences between colours.

In:  camera values, matrices, whites.
Out: tristimulus and display values, colour differences.
"""
