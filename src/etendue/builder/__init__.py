"""Pipelines written in Python: stages as values, a pipeline made of them, and what it gives, as TOML files and the
command line do.

stages  names of installed stages as functions, with signatures and help
pipeline  what ``etendue.Pipeline`` is
"""
