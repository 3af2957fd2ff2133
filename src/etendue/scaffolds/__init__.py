"""Beginnings: a distribution that brings a stage of one's own, and a commented pipeline. They work as they are written.

distribution  ``etendue new-plugin``
beginning     ``etendue new``
files         folders that are written whole or not at all
"""
