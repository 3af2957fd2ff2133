"""Methods that distributions add to pipelines and archives: ``etendue_methods``,
``{"Pipeline.compare": "module:function"}``.

In:  the name of a class and of a method.
Out: the function, bound to the pipeline or archive.
"""

from __future__ import annotations

from functools import partial, update_wrapper
from importlib.metadata import EntryPoint
from typing import Any

from etendue.calls import called
from etendue.plugins import discovery


class Extended:
    """A class to which distributions add methods; methods of the class itself take precedence."""

    def __getattr__(self, name: str) -> Any:
        if not name.startswith("_"):
            own = f"{type(self).__name__}.{name}"
            brought = discovery.installed().first("methods", own)
            if brought is not None:
                with discovery.foreign(f"{own} of {brought.origin} cannot be loaded"):
                    function = EntryPoint(name, str(brought.value), "").load()
                return update_wrapper(partial(called(function), self), function)
        raise AttributeError(
            f"{type(self).__name__} has no "
            f"{name!r}{discovery.installed().missed('methods', name) if name[:1] != '_' else ''}"
        )

    def __dir__(self) -> list[str]:
        brought = (name.partition(".") for name in discovery.installed().names("methods"))
        return sorted({*super().__dir__(), *(name for kind, _, name in brought if kind == type(self).__name__)})
