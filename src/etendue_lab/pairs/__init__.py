"""Pictures of random cameras with their noise-free values, for training."""
