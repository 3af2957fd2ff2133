"""The page of an archive: one HTML file that opens anywhere, or the same page served live.

In:  the folder of an archive whose run is finished, interrupted or in progress.
Out: a document of metrics, tables and pictures; HTML; a server for this machine only.
"""
