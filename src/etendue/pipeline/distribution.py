"""A new distribution with one stage that begins as a copy of an installed stage: it can be installed, passes the
conformance laws and can be compared.

In:  the name of the stage, its role, the stage that it copies.
Out: the texts of its files. The arithmetic is inherited until the author replaces it.
"""

from __future__ import annotations

import inspect
import keyword
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from inspect import cleandoc
from typing import Any

from etendue.contract.arrays.dims import dim
from etendue.contract.capabilities import is_transfer
from etendue.contract.registry import OWN, Registry
from etendue.contract.stage import identity_of, parameters_of, reads_of, writes_of
from etendue.contract.values.names import unfit_stage
from etendue.errors import Fault, RequestError, nearest
from etendue.plugins import discovery
from etendue.types.documents import DocumentView


@dataclass(frozen=True)
class Beginning:
    """The initial files of a new distribution."""

    stage: str  # its name in a pipeline
    role: str
    like: str  # the installed stage that it inherits from
    kind: Any

    @property
    def module(self) -> str:
        return f"etendue_{self.stage}"

    @property
    def distribution(self) -> str:
        return f"etendue-{self.stage.replace('_', '-')}"

    @property
    def name(self) -> str:
        return "".join(word.capitalize() for word in self.stage.split("_"))


def beginning(registry: Registry, stage: str, role: str | None, like: str | None) -> Beginning:
    """Check the arguments of ``etendue new-plugin`` and return the requested files.

    Raises
    ------
    RequestError
        If the name is invalid or taken, or the role or stage is unknown.
    """
    stage = stage.replace("-", "_").removeprefix("etendue_")
    roles = _by_role(registry)
    faults = [*_of_the_name(registry, stage), *_of_what_it_begins_as(registry, roles, role, like)]
    if faults:
        raise RequestError(faults)
    if like is None:
        assert role is not None
        like = _simplest().get(role) or next(
            (n for n in roles[role] if registry.installed(n).distribution == OWN), roles[role][0]
        )
    kind = registry.load(like)
    return Beginning(stage, kind.role, like, kind)


def _of_the_name(registry: Registry, stage: str) -> Iterator[Fault]:
    plain = stage.isidentifier() and stage.isascii() and re.match(r"[a-z]", stage) and not keyword.iskeyword(stage)
    if unfit_stage(stage) or not plain:
        yield Fault("NAME", f"{stage!r} is not a stage name: use lower-case letters, digits and _, a letter first")
    elif stage in registry:
        whose = registry.installed(stage).distribution
        yield Fault("NAME", f"{stage!r} is already installed, from {whose}; give another name")


def _of_what_it_begins_as(
    registry: Registry, roles: Mapping[str, list[str]], role: str | None, like: str | None
) -> Iterator[Fault]:
    if like is not None and like not in registry:
        yield Fault("--like", f"unknown stage {like!r}{nearest(like, registry.names())}")
    if role is not None and role not in roles:
        hint = f"{nearest(role, roles)}; roles: {', '.join(roles)}"
        yield Fault("--role", f"no installed stage has the role {role!r}{hint}")
    if role is None and like is None:
        yield Fault("--role", f"missing: give one of {', '.join(roles)}, or --like STAGE")
    if like is not None and like in registry and role in roles and (own := registry.load(like).role) != role:
        yield Fault("--like", f"{like} has the role {own!r}, not {role!r}")


def files(one: Beginning) -> Mapping[str, str]:
    """Return the texts of the files by path."""
    return {
        "pyproject.toml": _project(one),
        "README.md": _readme(one),
        f"src/{one.module}/__init__.py": f'"""{one.distribution}: the stage ``{one.stage}`` of etendue."""\n',
        f"src/{one.module}/manifest.py": _manifest(one),
        f"src/{one.module}/stages.py": _stage(one),
        "tests/test_conformance.py": _test(one),
    }


def _simplest() -> dict[str, str]:
    """Return, for roles with several built-in stages, the stage with the simplest arithmetic."""
    found = discovery.installed()
    return {
        role: str(brought.value) for role in found.names("beginnings") if (brought := found.first("beginnings", role))
    }


def _by_role(registry: Registry) -> dict[str, list[str]]:
    found: dict[str, list[str]] = {}
    for name in registry.fitting(lambda kind: bool(kind.role)):
        found.setdefault(registry.load(name).role, []).append(name)
    order = [*discovery.installed().names("roles"), *found]
    return {role: found[role] for role in dict.fromkeys(order) if role in found}


def _project(one: Beginning) -> str:
    return f"""\
[build-system]
requires = ["hatchling>=1.24"]
build-backend = "hatchling.build"

[project]
name = "{one.distribution}"
version = "0.1.0"
description = "The stage {one.stage} of etendue"
readme = "README.md"
requires-python = ">=3.11"
dependencies = ["etendue", "numpy>=2.0"]

[project.optional-dependencies]
test = ["pytest>=8", "hypothesis>=6.100"]

[project.entry-points.etendue]
{one.stage.replace("_", "-")} = "{one.module}.manifest"

[tool.hatch.build.targets.wheel]
packages = ["src/{one.module}"]
"""


def _manifest(one: Beginning) -> str:
    return f'''\
"""What this distribution brings to etendue: only names, so that nothing is imported before it is used."""

from __future__ import annotations

from etendue.api import hookimpl


@hookimpl
def etendue_stages() -> dict[str, str]:
    return {{"{one.stage}": "{one.module}.stages:{one.name}"}}
'''


def _readme(one: Beginning) -> str:
    ranked = f"etendue compare PIPELINE.toml --axis STAGE.use={one.like},{one.stage}"
    return f"""\
# {one.distribution}

The stage `{one.stage}` of etendue ({one.role}). For now it computes the same as `{one.like}`;
write your own arithmetic in `src/{one.module}/stages.py`.

    pip install -e ".[test]"
    pytest                          # the laws that every stage must satisfy
    etendue stages {one.stage}
    {ranked}

`PIPELINE.toml` has a stage named `STAGE` with `use = "{one.like}"`; `etendue new mine` writes a pipeline to start from.
"""


def _test(one: Beginning) -> str:
    return f'''\
"""The stage does what it declares: every law of the conformance kit is a test of this class."""

from {one.module}.stages import {one.name}

from etendue.testing import StageConformance
from etendue.testing.cases import ordinary


class Test{one.name}(StageConformance):
    stage = {one.name}(**ordinary({one.name}))
'''


def _stage(one: Beginning) -> str:
    package = one.kind.__module__.partition(".")[0]
    public = f"{package}.models" if package in discovery.own_packages() - {OWN} else one.kind.__module__
    first = cleandoc(one.kind.__doc__ or "").split("\n\n")[0].replace("\n", " ")
    taken = "\n".join(f"    #     {name}" for name in parameters_of(one.kind)) or "    #     none"
    return f'''\
"""The stage ``{one.stage}``, {one.role}.

{_listed("In: ", reads_of(one.kind))}
{_listed("Out:", writes_of(one.kind))}
{_coordinates(one)}"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from {public} import {one.kind.__name__}


@dataclass(frozen=True, kw_only=True)
class {one.name}({one.kind.__name__}):
    """One sentence that describes the method (authors and publication).

    It begins as ``{one.like}``: {first}
    """

    # Inherited parameters:
{taken}
    # Add one of your own, with its unit and range (from etendue.api import param):
    #     {_free(one.kind)}: float = param(1.0, at_least=0, at_most=10, doc="the effect of the parameter")
    # The stated error and gain are inherited too: state your own where your arithmetic differs, because the tests check
    # them.
{_method(one)}'''


def _free(kind: Any) -> str:
    """Return a name for a parameter that the class does not have yet: reusing an inherited name would change its
    meaning.
    """
    return next(
        name
        for name in ("strength", "amount", "extent", "own_strength")
        if not hasattr(kind, name) and name not in parameters_of(kind)
    )


def _listed(word: str, ports: DocumentView) -> str:
    told = [f"``{port}``: {str(declared).removeprefix(f'{port}: ')}" for port, declared in ports.items()]
    return f"{word} {'; '.join(told) or 'nothing'}."


COORDINATES = {
    "y": "rows: their positions, in pixels of the whole frame after sampling, in um on the image plane before it",
    "x": "columns, in the same way",
    "y_um": "rows: their positions on the image plane, um",
    "x_um": "columns, in the same way",
    "fy": "cycles/um along y",
    "fx": "cycles/um along x",
    "prepared": "the result of ``prepare``, made once for many calls",
    "rng": "random numbers for this cell only",
    "asked": "names of the requested optional variables",
}


def _coordinates(one: Beginning) -> str:
    """Describe the arguments that are not variables, one line each."""
    own = [p.name for p in _arguments(one)]
    return "".join(f"``{name}``: {said}.\n" for name in own if (said := _said_of(name)))


def _said_of(name: str) -> str:
    """Describe an argument that is not a variable; '' for a variable."""
    if name in COORDINATES:
        return COORDINATES[name]
    if whose := identity_of(name):
        return f"fixed patterns of the {whose}, each under its name: the same for every stage that asks for it"
    bands = dim(name.removesuffix("_edges"))
    if not bands.bins:
        return ""
    what = "edges" if name.endswith("_edges") else "centres"
    return f"{what} of the bands, {bands.units}{', one more than there are bands' if what == 'edges' else ''}"


def _method(one: Beginning) -> str:
    """Return the text of the method that computes, which calls the inherited method."""
    name, parameters = _computes(one), _arguments(one)
    asked = ", ".join(["self", *(_declared(p) for p in parameters)])
    given = ", ".join(p.name for p in parameters)
    what = (
        "the factor for the Fourier transform of the picture"
        if name == "transfer"
        else "{variable: array} of all outputs"
    )
    return f"""
    def {name}({asked}) -> Any:
        # Replace this line by your arithmetic; return {what}.
        return {one.kind.__name__}.{name}(self{", " if given else ""}{given})
"""


def _computes(one: Beginning) -> str:
    return "transfer" if is_transfer(one.kind) else "run"


def _arguments(one: Beginning) -> list[inspect.Parameter]:
    return list(inspect.signature(getattr(one.kind, _computes(one))).parameters.values())[1:]


def _declared(parameter: inspect.Parameter) -> str:
    default = "" if parameter.default is inspect.Parameter.empty else f" = {parameter.default!r}"
    return f"{parameter.name}: Any{default}"
