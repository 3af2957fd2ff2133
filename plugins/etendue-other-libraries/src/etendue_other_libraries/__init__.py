"""Algorithms of other libraries as stages of etendue: one module per library, so that a missing library disables only
its own stages.
"""
