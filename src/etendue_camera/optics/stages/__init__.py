"""The lens: light gathering and blur, uniform over the frame.

In:  ``radiance`` of the scene.
Out: ``irradiance``, blurred by transfer functions and filtered; lens metrics.
"""
