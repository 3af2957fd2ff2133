"""Studies of designs: sensitivity to the factors, and yield."""
