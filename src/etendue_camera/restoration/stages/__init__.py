"""Restoration of what blur and noise removed: sharpening, denoising, deconvolution.

In:  planes or a mosaic, and the camera's transfer functions.
Out: the same variable, restored.
"""
