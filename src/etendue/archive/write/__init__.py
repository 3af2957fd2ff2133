"""Archives written: the store of a run, keeping and removing results, compaction, results in memory."""
