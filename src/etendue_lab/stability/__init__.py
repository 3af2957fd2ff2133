"""Numerical stability of every installed stage, of the kernels below them, and of whole cameras at extremes.

``rows`` holds results; ``stages`` tests instances of a stage against the laws of the conformance kit; ``kernels``
closed forms; ``cameras`` whole cameras, ``camera_laws`` their laws; ``study`` runs everything, in processes.
"""
