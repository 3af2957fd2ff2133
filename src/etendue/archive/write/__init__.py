"""Archives written: the store of a run, what it keeps and removes, compaction, results in memory."""
