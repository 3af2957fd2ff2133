"""Restoration after blur and noise: sharpening, denoising, deconvolution.

In:  planes, and the transfer function that blurred them, if known.
Out: planes of the same kind.
"""
