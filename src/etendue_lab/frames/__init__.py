"""Real frames: flat fields and dark frames of a camera, from files of many kinds."""
