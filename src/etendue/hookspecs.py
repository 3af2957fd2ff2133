"""The one hook a plugin implements, found through the entry-point group ``etendue.stages``.

One entry point per stage: its name is the stage's name, its value a module with

    @etendue.api.hookimpl
    def etendue_stages():
        return {"my_stage": MyStage}
"""

from __future__ import annotations

import pluggy

PROJECT = "etendue"
GROUP = "etendue.stages"
hookspec = pluggy.HookspecMarker(PROJECT)
hookimpl = pluggy.HookimplMarker(PROJECT)


@hookspec
def etendue_stages() -> dict[str, type]:  # type: ignore[empty-body]
    """Stage classes by the names under which they are entry points."""
