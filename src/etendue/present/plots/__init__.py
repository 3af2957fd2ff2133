"""Plots of the content of an archive: maps, curves, picture strips, Pareto fronts, limiting factors, budgets; and
upright pictures.

In:  an ``xarray.DataTree`` from an archive or a run in memory, or the folder of an archive; names of metrics and axes.
Out: a ``Plot``, which can be saved as PNG, SVG or PDF, is shown by notebooks, and holds the plotted numbers.

``holdings`` lists the content, ``arrangement`` assigns axes to sides and panels, ``labels`` formats values; each kind
of plot has a file; ``pictures`` converts an array to the colours that an eye sees; ``accessor`` adds the plots to
xarray's objects. matplotlib is imported when something is drawn.
"""
