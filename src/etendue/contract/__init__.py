"""The words of a request and of a stage: declarations, parameters, units, grids, the pipeline file, ports between
rooms.

In:  text and classes.
Out: frozen values that the rooms above agree on. No arrays.
"""
