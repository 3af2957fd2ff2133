"""Cells as chunks, and chunks in shards: splitting, writing, locating and decoding."""
