"""Real frames: flat fields and dark frames of a camera, read from several file formats."""
