"""Pages of the site that are made when it is built: of what is installed, of the command line, of pictures that cameras
take.

In:  the registry, the commands, the shipped pipelines, and the files at the top of the repository.
Out: markdown and PNG below ``docs/made``, which is not committed.
"""
