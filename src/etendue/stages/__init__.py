"""Built-in stages: a few lines around a kernel, in the same wings as the kernels.

scene -> optics -> field -> sensor -> electronics -> mosaic -> restoration -> colour -> resolution -> quality.
They enter through the same hooks as anybody's, and nothing in the engine knows one of them by name or class.
"""
