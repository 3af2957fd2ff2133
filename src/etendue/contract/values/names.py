"""Names that become folders, dims and columns of an archive: which are free, and which would take the place of
something else.

In:  names of stages and of variables, as a pipeline or a plugin gives them.
Out: '' where a name may be used, else why not.
"""

from __future__ import annotations

from collections.abc import Iterable

TABLES = ("ledger", "summary", "frames")  # groups of an archive beside its stages
LOOKS = "looks"  # under `keep`: what people look at
OWN = ("status",)  # an array in every group beside the variables of a stage
LONGEST = 100  # characters: with the axes of a cell in it a name of a file has 255 bytes


def beside(dims: Iterable[str]) -> set[str]:
    """Dims and the names of coordinates that an archive may have of them."""
    return {own for dim in dims for own in (dim, f"{dim}_um", f"{dim}_at", f"{dim}_bounds")}


def unfit_stage(name: str) -> str:
    """Why a stage may not be named so."""
    if not name.replace("_", "a").replace("-", "a").isalnum():
        return "expected letters, digits and _"
    if name == LOOKS:
        return f"{LOOKS!r} under 'keep' means pictures and figures of all stages; name the stage otherwise"
    if name.lower() in TABLES:
        return f"an archive has a table named {name.lower()!r}; name the stage otherwise"
    if name.startswith("__"):
        return "names that begin with __ belong to Zarr"
    if len(name.encode(errors="replace")) > LONGEST:
        return f"expected at most {LONGEST} letters"
    return ""


def unfit_variable(name: str, dims: Iterable[str]) -> str:
    """Why a stage whose outputs have these dims may not write a variable of this name."""
    if not name.isidentifier() or name.startswith("__"):
        return "expected letters, digits and _"
    if name == LOOKS:
        return f"{LOOKS!r} under 'keep' means pictures and figures of all stages"
    if name in OWN:
        return "every group of an archive has an array of this name of its own"
    if name in beside(dims):
        return "a coordinate of what the stage writes has this name"
    if len(name) > LONGEST:
        return f"expected at most {LONGEST} letters"
    return ""
