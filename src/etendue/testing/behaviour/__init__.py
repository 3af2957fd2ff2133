"""Checks of a stage's behaviour at places, over ranges of values, and for codes, noise and state; ``laws`` has a test
method for each check.
"""
