"""What people see: tables, pictures, plots, and what stands on a terminal.

In:  documents, plans, reports, arrays.
Out: text, PNG, tables of an archive.
"""
