"""The shared vocabulary of requests and stages: declarations, parameters, units, grids, the pipeline file, and ports
between packages.

In:  text and classes.
Out: frozen values that the higher layers agree on. No arrays.
"""
