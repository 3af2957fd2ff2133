"""Pages that are generated when the site is built: from installed stages, from the command line, and from pictures that
cameras take.

In:  the registry, the commands, the shipped pipelines, and the files at the top of the repository.
Out: markdown and PNG below ``docs/made``, which is not committed.
"""
