"""etendue: plan, sweep, archive and show any graph of replaceable stages on labelled arrays."""

import sys
from types import ModuleType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from etendue.archive.places import open_archive
    from etendue.builder.archives import Archive
    from etendue.builder.pipeline import Pipeline, span
    from etendue.builder.simulating import simulate
    from etendue.pipeline.file import read_pipeline
    from etendue.present.plots.accessor import show

__all__ = ["Archive", "Pipeline", "open_archive", "read_pipeline", "show", "simulate", "span", "stages"]

_PLACES = {
    "Archive": "etendue.builder.archives",
    "Pipeline": "etendue.builder.pipeline",
    "show": "etendue.present.plots.accessor",
    "span": "etendue.builder.pipeline",
    "simulate": "etendue.builder.simulating",
    "read_pipeline": "etendue.pipeline.file",
    "open_archive": "etendue.archive.places",
}


class _Package(ModuleType):
    """Imports names on first use; ``stages`` gives every installed stage by name."""

    def __getattr__(self, name: str) -> Any:
        if name in _PLACES:
            from importlib import import_module

            found = getattr(import_module(_PLACES[name]), name)
            _with_plots(name == "open_archive")
            return found
        raise AttributeError(f"module 'etendue' has no attribute {name!r}")

    def __dir__(self) -> list[str]:
        return sorted({*super().__dir__(), *__all__})

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle by name, like any module, so that a notebook function that uses the package can be sent to another
        process.
        """
        from importlib import import_module

        return import_module, (self.__name__,)

    @property
    def stages(self) -> Any:
        """Installed stages, as functions that place them in a pipeline."""
        from etendue.builder.stages import STAGES

        return STAGES


sys.modules[__name__].__class__ = _Package


def _with_plots(needed: bool = False) -> None:
    """Register ``tree.etendue`` if xarray is loaded or ``needed``; otherwise xarray finds it through its engines."""
    if needed or "xarray" in sys.modules:
        from etendue.present.plots import accessor  # noqa: F401


_with_plots()
