"""Pictures of random cameras with their truth, for training."""
