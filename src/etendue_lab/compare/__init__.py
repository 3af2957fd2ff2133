"""Alternatives ranked: quality against run time."""
