"""etendue: a digital camera, from scene light to display colour, as a graph of replaceable stages."""

from typing import Any

__all__ = ["read_pipeline", "simulate"]


def simulate(*args: Any, **kwargs: Any) -> Any:
    """Run a pipeline and return its ``xarray.DataTree``; see ``etendue.session.simulate``."""
    from etendue.session import simulate as run

    return run(*args, **kwargs)


def read_pipeline(path: Any) -> Any:
    """The pipeline in a file, checked for form."""
    from pathlib import Path

    from etendue.spec.pipeline import read_pipeline as read

    return read(Path(path))
