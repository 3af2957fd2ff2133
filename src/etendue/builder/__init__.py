"""Pipelines written in Python: stages as values, a pipeline made of them, and its results; equivalent to TOML files and
the command line.

stages  names of installed stages as functions, with signatures and help
pipeline  the class ``etendue.Pipeline``
"""
