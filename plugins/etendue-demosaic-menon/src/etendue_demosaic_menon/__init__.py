"""Menon's directional demosaicing for etendue, computed by colour-demosaicing."""
