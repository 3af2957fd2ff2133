"""An archive as a page: one HTML file that opens anywhere, or the same page live beside the store.

In:  the folder of an archive, finished, interrupted or being written.
Out: a document of figures, tables and pictures; HTML; a server on this machine alone.
"""
