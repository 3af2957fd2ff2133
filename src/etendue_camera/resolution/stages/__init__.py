"""Resolution: contrast by frequency, edges, stars, textures.

In:  the transfer functions of all stages, or their pictures of a chart.
Out: resolution metrics by stage.
"""
