"""Archives on object stores: whole objects, the lease of a writer, stubs in place of remote shards."""
