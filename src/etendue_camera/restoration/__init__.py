"""Restoration of what blur and noise removed: sharpening, denoising, deconvolution.

In:  planes, and where it is known the transfer function that blurred them.
Out: planes of the same kind.
"""
