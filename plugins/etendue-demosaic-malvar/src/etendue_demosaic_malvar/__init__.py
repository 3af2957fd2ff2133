"""Malvar-He-Cutler linear demosaicing for etendue."""
