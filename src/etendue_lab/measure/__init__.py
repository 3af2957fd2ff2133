"""``etendue measure``: a photograph measured with the same methods as simulated pictures: edges, stars, noise, a
ColorChecker.

In:  a picture file, regions of it (pixels).
Out: a document: MTF50, noise and colour differences, each with an interval.
"""
