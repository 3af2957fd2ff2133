"""Numerical stability of every installed stage, of the kernels below them, and of whole cameras at extremes.

``rows`` what is found; ``stages`` instances of a stage against the laws of the conformance kit; ``kernels`` closed
forms; ``cameras`` whole cameras, ``camera_laws`` what they obey; ``study`` all of it, in processes.
"""
