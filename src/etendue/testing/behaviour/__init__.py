"""Checks of how a stage treats places, ranges of values, codes, noise and state; ``laws`` has a test method for each
check.
"""
