"""Alternatives ranked by quality against run time."""
