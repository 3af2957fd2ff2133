"""Questions that take many runs: alternatives ranked, a camera against its ideal, noise behind every stage.

In:  a pipeline and what is asked.
Out: a document, tables, figures.
"""
