"""The request: the pipeline file, its schema, and what one begins with.

In:  text.
Out: frozen values and faults. No arrays.
"""
