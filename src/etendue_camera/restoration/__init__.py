"""What blur and noise took, brought back: sharpening, denoising, deconvolution.

In:  planes, and where it is known the transfer function that blurred them.
Out: planes of the same kind.
"""
