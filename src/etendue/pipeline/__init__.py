"""The request: the pipeline file, its schema, and templates to start from.

In:  text.
Out: frozen values and faults. No arrays.
"""
