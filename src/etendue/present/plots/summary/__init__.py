"""The summary of an archive or run: its state, axes, metrics and pictures."""
