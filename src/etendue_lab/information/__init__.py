"""Bits per pixel of fine detail, and the loss at every stage."""
