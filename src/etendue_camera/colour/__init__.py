"""Colour: from camera primaries to XYZ, white, the display and its encoding; colour differences.

In:  camera values, matrices, whites.
Out: tristimulus and display values, colour differences.
"""
