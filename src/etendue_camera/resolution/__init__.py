"""Resolution: contrast by frequency, edges, stars, textures.

In:  transfer functions, or pictures of edges, stars and leaves.
Out: contrast, MTF50, limits and their intervals.
"""
