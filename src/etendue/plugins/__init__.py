"""What distributions bring: hooks, discovery, and their code at work."""
