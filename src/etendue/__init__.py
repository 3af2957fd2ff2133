"""etendue: a digital camera, from scene light to display colour, as a graph of replaceable stages."""

from typing import Any

__all__ = ["read_pipeline", "simulate"]


def simulate(*args: Any, **kwargs: Any) -> Any:
    """Run a pipeline (path, TOML text or mapping) and return its ``xarray.DataTree``.

    Keywords: ``archive`` (folder to keep and resume; default in memory), ``want`` (variables), ``scheduler`` (serial, threads,
    processes, tcp://...), ``workers``, ``leave_out``. All others are parameters: camera quantities by name, those of a stage as
    ``stage__parameter``; a list makes a sweep axis: ``simulate("paper.toml", f_number=[2, 4], sharpen__strength=0.3)``.
    Raises ``RequestError`` with every fault of the file.
    """
    from etendue.session import simulate as run

    return run(*args, **kwargs)


def read_pipeline(path: Any) -> Any:
    """The pipeline in a file, checked for form."""
    from pathlib import Path

    from etendue.spec.pipeline import read_pipeline as read

    return read(Path(path))
