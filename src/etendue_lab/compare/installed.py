"""Stages that a study adds to a pipeline, found among the installed stages by role or base, never by name.

In:  a registry; a role with inputs and outputs, or a typed base.
Out: the name under which such a stage is installed. Stages of the package come first.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from etendue.contract.registry import Registry
from etendue.contract.stage import reads_of, writes_of
from etendue.errors import RequestError
from etendue_camera.roles import REFERENCE

if TYPE_CHECKING:
    from etendue.contract.stage import Stage


def serving(registry: Registry, role: str, reads: str, writes: str, dims: tuple[str, ...] = ()) -> str:
    """Return the installed stage that has a role, reads one variable (with these dims if given) and writes another
    variable; '' if there is none.
    """

    def fits(kind: type[Stage]) -> bool:
        read = [d for d in reads_of(kind).values() if d.variable == reads and d.dims == (dims or d.dims)]
        return bool(kind.role == role and read) and any(d.variable == writes for d in writes_of(kind).values())

    return next(registry.fitting(fits), "")


def made_for(registry: Registry, base: type) -> str:
    """Return the installed stage that is derived from a base class, such as a flat scene.

    Raises
    ------
    RequestError
        No such stage is installed.
    """
    name = next(registry.fitting(lambda kind: issubclass(kind, base)), "")
    if not name:
        raise RequestError(f"no installed stage derives from {base.__name__}: {(base.__doc__ or '').strip()}")
    return name


def reference(registry: Registry, reads: str, writes: str, dims: tuple[str, ...]) -> str:
    """Return the stage that only serves in references and reads and writes these variables.

    Raises
    ------
    RequestError
        None is installed.
    """
    name = serving(registry, REFERENCE, reads, writes, dims)
    if not name:
        raise RequestError(f"no installed stage of the role {REFERENCE!r} makes {writes} from {reads}")
    return name
