"""The verified store of an archive: every chunk is checked against the journal when it is read."""
