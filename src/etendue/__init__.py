"""etendue: a digital camera, from scene light to display colour, as a graph of replaceable stages."""

import sys
from types import ModuleType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from etendue.archive.places import open_archive
    from etendue.composing.pipeline import Pipeline, span
    from etendue.session import simulate
    from etendue.spec.pipeline import read_pipeline

__all__ = ["Pipeline", "open_archive", "read_pipeline", "simulate", "span", "stages"]

_PLACES = {
    "Pipeline": "etendue.composing.pipeline",
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

            return getattr(import_module(_PLACES[name]), name)
        raise AttributeError(f"module 'etendue' has no attribute {name!r}")

    def __dir__(self) -> list[str]:
        return sorted({*super().__dir__(), *__all__})

    @property
    def stages(self) -> Any:
        """Installed stages as functions that place them in a pipeline."""
        from etendue.composing.stages import STAGES

        return STAGES

    @stages.setter
    def stages(self, module: ModuleType) -> None:
        """The import of the package ``etendue.stages`` ends here."""


sys.modules[__name__].__class__ = _Package
