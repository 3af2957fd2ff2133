"""Archives on object stores: whole objects, the lease of a writer, stubs that stand for remote shards."""
