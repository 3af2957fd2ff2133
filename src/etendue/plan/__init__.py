"""What is computed, before anything is: a pipeline as a graph, its sweep as cells, their keys, costs and errors. No
arrays.

In:  a pipeline (``spec``), the stages that are installed (``registry``).
Out: a ``Plan``, or every fault of the request at once.
"""
