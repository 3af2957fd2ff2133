"""What blur and noise took, brought back: sharpening, denoising, deconvolution.

In:  planes or a mosaic, and the camera's transfer functions.
Out: the same variable, restored.
"""
