"""Algorithms of other libraries as stages of etendue: a module per library, so that one that is not installed lacks
alone.
"""
