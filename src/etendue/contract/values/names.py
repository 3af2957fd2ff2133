"""Names that become folders, dims and columns of an archive: valid names, and reserved names.

In:  names of stages and of variables, as a pipeline or a plugin gives them.
Out: '' if a name may be used, else the reason why it may not.
"""

from __future__ import annotations

from collections.abc import Iterable

TABLES = ("ledger", "summary", "frames")  # groups of an archive that are not stages
STUDY = "study"  # attribute of a group of an archive that a study has stored
LOOKS = "looks"  # under `keep`: pictures and metrics, without light by band
OWN = ("status",)  # an array in every group that is not a variable of the stage
LONGEST = 100  # characters; with the axes of a cell added, a file name must stay within 255 bytes


def beside(dims: Iterable[str]) -> set[str]:
    """Return dims and the names of the coordinates that an archive may have for these dims."""
    return {own for dim in dims for own in (dim, f"{dim}_um", f"{dim}_at", f"{dim}_bounds")}


def unfit_stage(name: str) -> str:
    """Return the reason why a stage may not have this name; '' if it may."""
    if not name.replace("_", "a").replace("-", "a").isalnum():
        return "expected letters, digits and _"
    if name == LOOKS:
        return f"{LOOKS!r} under 'keep' means pictures and metrics of all stages; give the stage another name"
    if name.lower() in TABLES:
        return f"an archive has a table named {name.lower()!r}; give the stage another name"
    if name.startswith("__"):
        return "names that begin with __ are reserved for Zarr"
    if len(name.encode(errors="replace")) > LONGEST:
        return f"expected at most {LONGEST} letters"
    return ""


def unfit_variable(name: str, dims: Iterable[str]) -> str:
    """Return the reason why a stage whose outputs have these dims may not write a variable of this name; ''
    if it may.
    """
    if not name.isidentifier() or name.startswith("__"):
        return "expected letters, digits and _"
    if name == LOOKS:
        return f"{LOOKS!r} under 'keep' means pictures and metrics of all stages"
    if name in OWN:
        return "every group of an archive has an array with this name"
    if name in beside(dims):
        return "a coordinate of an output of the stage has this name"
    if len(name) > LONGEST:
        return f"expected at most {LONGEST} letters"
    return ""
