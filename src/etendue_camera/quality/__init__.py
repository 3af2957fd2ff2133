"""Picture quality: against a reference, and to an observer.

In:  a picture and what it should be.
Out: PSNR, SSIM, S-CIELAB, visible noise, artefacts.
"""
