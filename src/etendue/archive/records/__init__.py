"""The descriptions of an archive: owner, manifest, inputs, provenance, crate; and all disk access."""
