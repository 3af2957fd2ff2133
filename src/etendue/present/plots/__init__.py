"""Plots of what an archive holds: maps, curves, strips of pictures, fronts, what limits, budgets; and pictures the
right way up.

In:  an ``xarray.DataTree`` as archives and runs in memory give it, or the folder of an archive; names of figures and
     axes.
Out: a ``Plot``, which is saved as PNG, SVG or PDF and shown by notebooks, with the numbers that are drawn.

``holdings`` says what there is, ``arrangement`` which axis goes where, ``labels`` how values are written; a file for
each kind of plot; ``pictures`` gives an array the colours that an eye sees; ``accessor`` puts all of it on xarray's
objects. matplotlib is imported when something is drawn.
"""
