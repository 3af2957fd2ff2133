"""Bits per pixel of fine detail, and where they are lost."""
