"""A digital camera, from scene light to display colour: a plugin of etendue like any other.

A package for each subject, along the light: kernels are plain functions on arrays, ``stages`` beside them declare what
they read and write.
"""
