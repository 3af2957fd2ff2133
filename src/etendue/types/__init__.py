"""What values are called in annotations: nothing here computes."""
