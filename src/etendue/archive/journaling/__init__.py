"""The journal of finished cells, its lines, and the entries and shards that it accounts for."""
