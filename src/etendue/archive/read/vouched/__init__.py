"""The store of an archive, whose chunks are checked against its journal: by chunk, by shard, in columns."""
