"""Field-dependent effects: falloff, vignetting, distortion, point spread functions.

In:  planes of light, positions on the image plane.
Out: the same planes displaced, attenuated or blurred by position.
"""
