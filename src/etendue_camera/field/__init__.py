"""What changes over the frame: fall-off, vignetting, distortion, point spread functions by field.

In:  planes of light, positions on the image plane.
Out: the same planes moved, darkened or blurred by place.
"""
