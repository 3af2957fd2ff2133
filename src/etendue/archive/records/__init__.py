"""What describes an archive beside its cells: owner, manifest, inputs, provenance, crate; and all disk access."""
