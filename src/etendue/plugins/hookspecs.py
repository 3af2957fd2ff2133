"""What a distribution may bring: one hook for each vocabulary, in one small manifest module, named by one entry point.

    [project.entry-points.etendue]
    my-film = "my_film.manifest"

The manifest is imported whenever anything is looked up, so it imports little; stages are named as text and imported
when they are used. Every hook gives a mapping by name. Two distributions that give one name are a fault of the pipeline
that uses it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import pluggy

from etendue.types.documents import DocumentView

PROJECT = "etendue"
GROUP = "etendue"
FORMER_GROUP = "etendue.stages"  # one entry point per stage: no longer read
hookspec = pluggy.HookspecMarker(PROJECT)
hookimpl = pluggy.HookimplMarker(PROJECT)


@hookspec
def etendue_stages() -> Mapping[str, str | type]:  # type: ignore[empty-body]
    """Stages: where their class stands, or the class itself.

    {"halation": "my_film.stages:Halation"}
    """


@hookspec
def etendue_variables() -> Mapping[str, DocumentView]:  # type: ignore[empty-body]
    """Variables that stages write: meaning, unit, and how a contact sheet shows them (``spec.variables.Variable``).

    {"halo": {"long_name": "light scattered by the film's base", "shown": "linear"}}
    """


@hookspec
def etendue_quantities() -> Mapping[str, DocumentView]:  # type: ignore[empty-body]
    """Quantities that stages share, under one table of a pipeline file: the words of ``param()``, and a default unless
    it must be given.

    {"film_thickness": {"default": 120.0, "units": "um", "above": 0, "doc": "of the film's base"}}
    """


@hookspec
def etendue_roles() -> Mapping[str, str]:  # type: ignore[empty-body]
    """What stages are alternatives to, in a sentence.

    {"halation": "light that comes back from behind the sensitive layer"}
    """


@hookspec
def etendue_vocabularies() -> Mapping[str, DocumentView]:  # type: ignore[empty-body]
    """Further hooks, which a domain has for itself and whoever builds upon it: each gives a mapping by name
    (``discovery.Vocabulary``).

    {"stocks": {"word": "film stock"}}: others bring ``etendue_stocks()``
    """


@hookspec
def etendue_dims() -> Mapping[str, DocumentView]:  # type: ignore[empty-body]
    """Dims that are cut into bands, or have a unit and a name of their own (``contract.dims.Dim``). Stages may ask for
    the coordinates of a dim by its name, and for the edges of its bands as ``NAME_edges``.

    {"frequency": {"bins": True, "units": "Hz", "long_name": "frequency"}}
    """


@hookspec
def etendue_units() -> Mapping[str, str]:  # type: ignore[empty-body]
    """Units beside those of the SI: '' for one that is made of no others, or what one of it is.

    {"grain": "", "stop": "0.3 grain"}
    """


@hookspec
def etendue_patterns() -> Mapping[str, str]:  # type: ignore[empty-body]
    """Generators of fixed patterns, random numbers by absolute position that are the same in every cell: the argument
    of ``run`` by which a stage asks for one, and the shared quantity that says whose patterns they are.

    {"rng_film": "film_serial"}
    """


@hookspec
def etendue_commands() -> Mapping[str, DocumentView]:  # type: ignore[empty-body]
    """Commands of the program ``etendue``: where the click command stands, how it is typed, what it does
    (``cli.commands.Command``).

    {"halation": {"place": "my_film.cli:halation", "usage": "FILE", "doc": "how far light comes back from the base"}}
    """


@hookspec
def etendue_methods() -> Mapping[str, str]:  # type: ignore[empty-body]
    """Methods of ``etendue.Pipeline`` and ``etendue.Archive``: a function whose first argument is the one or the other.

    {"Pipeline.halation": "my_film.study:halation_of"}
    """


@hookspec
def etendue_shares() -> Mapping[str, str]:  # type: ignore[empty-body]
    """What says the share of each stage in what is lost: ``function(folder, at, told)`` gives ``losses``, ``notes``,
    and ``why`` where there are none.

    {"halation": "my_film.study:shares_at"}
    """


@hookspec
def etendue_seen() -> Mapping[str, str]:  # type: ignore[empty-body]
    """How arrays become colours: for a dim in front of y and x a function of (drawn, edges, names) that gives (3, n)
    from its n planes to linear sRGB, or None for the first three as they are; for ``pattern`` a function of its text
    that gives rows and colours by letter.

    {"layer": "my_film.seen:of_layers"}
    """


@hookspec
def etendue_tables() -> Mapping[str, DocumentView]:  # type: ignore[empty-body]
    """The name of the table under which shared quantities stand, and how sets of values are named in it
    (``contract.tables.Table``).

    {"film": {"preset": "stock", "presets": "stocks"}}: ``[film] stock = "NAME"``, brought by ``etendue_stocks()``, a
    file or mapping each
    """


@hookspec
def etendue_templates() -> Mapping[str, DocumentView]:  # type: ignore[empty-body]
    """Commented pipelines to begin with, for ``etendue new`` (``pipeline.beginning.Template``).

    {"film": {"path": Path(__file__).parent / "film.toml", "keep": {"all": "everything"}}}
    """


@hookspec
def etendue_beginnings() -> Mapping[str, str]:  # type: ignore[empty-body]
    """By role, the stage that ``etendue new-plugin`` begins as: the one whose arithmetic is read fastest.

    {"halation": "halation_gaussian"}
    """


@hookspec
def etendue_elsewhere() -> Mapping[str, DocumentView]:  # type: ignore[empty-body]
    """Stages that other distributions bring: named where a pipeline uses them and they are not installed.

    {"my-film-scanner": {"stages": ["scanner_glare"]}}
    """


@hookspec
def etendue_plots() -> Mapping[str, DocumentView]:  # type: ignore[empty-body]
    """Kinds of plots: where ``function(holdings, asked)`` stands, how many variables it takes, what it goes by
    (``plots.kinds.Kind``).

    It gives a figure of matplotlib. ``held = holdings.find("mean_level")`` is a variable, ``held.values()`` its array
    over all axes, and ``held.values(asked.cell(held))`` that of the one cell that was asked for; ``asked.figures`` are
    the names that were given.

    {"rose": {"place": "my_weather.plots:rose", "takes": 1, "uses": ["at"], "doc": "how often the wind blows from
    where"}}
    """


@hookspec
def etendue_sections() -> Mapping[str, DocumentView]:  # type: ignore[empty-body]
    """Sections of a page: where ``function(tree)`` stands, and the title. It is given what ``etendue.open_archive``
    gives, and gives a list of ``{"paragraph": text}``, ``{"table": {"head": [...], "rows": [[...], ...]}}`` and
    ``{"picture": bytes of a PNG, "alt": text}``; an empty one where it has nothing to say.

    {"rain": {"place": "my_weather.page:rain", "title": "How much it rained"}}
    """


@hookspec
def etendue_first() -> Mapping[str, Sequence[str]]:  # type: ignore[empty-body]
    """What goes first where there is a choice: names of variables under ``map``, ``sheet``, ``glance``, ``headline``,
    ``curves``, ``picture``; two in a text under ``front``; of axes under ``sides`` and ``along``; of shared quantities
    under ``quantities``.

    {"map": ["rainfall", "mean_wind"], "front": ["rainfall mean_wind"]}
    """


@hookspec
def etendue_words() -> Mapping[str, str]:  # type: ignore[empty-body]
    """What things are called in sentences of plots and pages (``contract.wording.WORDS``).

    {"cell": "forecast", "whole": "model"}
    """


@hookspec
def etendue_spelling() -> Mapping[str, str]:  # type: ignore[empty-body]
    """How parts of names are written out on a page; a name that begins with ``_`` is the end of one.

    {"rh": "relative humidity"}
    """


@hookspec
def etendue_subjects() -> Mapping[str, DocumentView]:  # type: ignore[empty-body]
    """What figures are about, in the order of a page (``contract.wording.Subject``); ``Variable.subject`` names one of
    them.

    {"rain": {"said": "rainfall", "opens": True}}
    """


@hookspec
def etendue_examples() -> DocumentView:  # type: ignore[empty-body]
    """What stages are tried with that look at others: under ``datasheet`` a role and figures.

    {"datasheet": {"role": "gauge", "figures": {"offset": 0.1}}}
    """


@hookspec
def etendue_scales() -> Mapping[str, DocumentView]:  # type: ignore[empty-body]
    """What is said of units beyond their size (``contract.wording.Unit``).

    {"hPa": {"full": 1013.0}}
    """
