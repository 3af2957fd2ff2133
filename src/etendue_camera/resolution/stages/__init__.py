"""How fine a detail survives: contrast by frequency, edges, stars, textures.

In:  the transfer functions of all stages, or their pictures of a chart.
Out: figures of resolution by stage.
"""
