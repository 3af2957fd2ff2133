"""Plugins: hooks, discovery, and isolation of foreign code."""
