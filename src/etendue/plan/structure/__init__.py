"""What a plan consists of: axes, nodes and cells."""
