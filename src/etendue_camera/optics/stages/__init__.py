"""The lens: how much light it gathers and where a point goes, the same all over the frame.

In:  ``radiance`` of the scene.
Out: ``irradiance``, gathered, blurred by transfer functions, filtered; numbers of the lens.
"""
