"""Restoration after blur and noise: sharpening, denoising, deconvolution.

In:  planes or a mosaic, and the camera's transfer functions.
Out: the same variable, restored.
"""
