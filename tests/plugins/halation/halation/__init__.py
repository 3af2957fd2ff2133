"""Film: light that comes back from behind the sensitive layer. A distribution that brings words of its own of every
kind.
"""
