"""Formulas as they stand in textbooks, and the same in the form that survives: a distribution that a check of
stability must tell apart.
"""
