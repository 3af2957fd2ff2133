"""What describes an archive beside its cells: owner, manifest, inputs, provenance, crate; and the door to the disk."""
