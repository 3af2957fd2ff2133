"""etendue: a digital camera, from scene light to display colour, as a graph of replaceable stages."""

import sys
from types import ModuleType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from etendue.archive.places import open_archive
    from etendue.composing.archives import Archive
    from etendue.composing.pipeline import Pipeline, span
    from etendue.plots.accessor import show
    from etendue.session import simulate
    from etendue.spec.pipeline import read_pipeline

__all__ = ["Archive", "Pipeline", "open_archive", "read_pipeline", "show", "simulate", "span", "stages"]

_PLACES = {
    "Archive": "etendue.composing.archives",
    "Pipeline": "etendue.composing.pipeline",
    "show": "etendue.plots.accessor",
    "span": "etendue.composing.pipeline",
    "simulate": "etendue.session",
    "read_pipeline": "etendue.spec.pipeline",
    "open_archive": "etendue.archive.places",
}


class _Package(ModuleType):
    """Imports what is asked for; ``stages`` is every installed stage by its name, though the package of that name has been imported."""

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
        """Sent to another process by name, as every module: what a function in a notebook uses goes with it."""
        from importlib import import_module

        return import_module, (self.__name__,)

    @property
    def stages(self) -> Any:
        """Installed stages as functions that place them in a pipeline."""
        from etendue.composing.stages import STAGES

        return STAGES

    @stages.setter
    def stages(self, module: ModuleType) -> None:
        """The import of the package ``etendue.stages`` ends here."""


sys.modules[__name__].__class__ = _Package


def _with_plots(needed: bool = False) -> None:
    """``tree.etendue``, where xarray is there, or will be; else xarray asks for it when it looks for engines."""
    if needed or "xarray" in sys.modules:
        from etendue.plots import accessor  # noqa: F401


_with_plots()
