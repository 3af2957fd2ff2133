"""Cells as chunks, chunks in shards: how they are cut, written, found and unpacked."""
