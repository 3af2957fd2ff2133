"""Picture quality: against a reference, and to an observer.

In:  a picture and its reference.
Out: PSNR, SSIM, S-CIELAB, visible noise, artefacts.
"""
