"""Planning: a pipeline as a graph, its sweep as cells, with their keys, costs and errors. No arrays.

In:  a pipeline (``spec``) and the installed stages (``registry``).
Out: a ``Plan``, or all faults of the request in one error.
"""
