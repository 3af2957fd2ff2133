"""A digital camera, from scene light to display colour: a plugin of etendue like any other.

One package per subject, in the order of the light path: kernels are plain functions on arrays, and their ``stages``
declare what they read and write.
"""
