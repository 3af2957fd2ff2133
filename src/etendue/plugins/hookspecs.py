"""The hooks that a distribution may implement: one hook per vocabulary, in a small manifest module named by one entry
point.

    [project.entry-points.etendue]
    my-film = "my_film.manifest"

The manifest is imported for every look-up, so it should import little; stages are named as text and imported on use.
Every hook returns a mapping by name. If two distributions provide the same name, pipelines that use it report a fault.
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
def etendue_stages() -> Mapping[str, str | type]:
    """Stages: the location of their class, or the class itself.

    {"halation": "my_film.stages:Halation"}
    """


@hookspec
def etendue_variables() -> Mapping[str, DocumentView]:
    """Variables that stages write: meaning, unit, and how a contact sheet shows them (``spec.variables.Variable``).

    {"halo": {"long_name": "light scattered by the film's base", "shown": "linear"}}
    """


@hookspec
def etendue_quantities() -> Mapping[str, DocumentView]:
    """Quantities that stages share, under one table of a pipeline file: the keywords of ``param()``, and a default
    unless the value is required.

    {"film_thickness": {"default": 120.0, "units": "um", "above": 0, "doc": "of the film's base"}}
    """


@hookspec
def etendue_roles() -> Mapping[str, str]:
    """Roles, each with one sentence about the purpose of its stages; stages of one role are alternatives to each other.

    {"halation": "light that comes back from behind the sensitive layer"}
    """


@hookspec
def etendue_vocabularies() -> Mapping[str, DocumentView]:
    """More hooks that a distribution defines for its domain: it and distributions that build upon it implement them.
    Each hook returns a mapping by name (``discovery.Vocabulary``).

    {"stocks": {"word": "film stock"}}: others bring ``etendue_stocks()``
    """


@hookspec
def etendue_dims() -> Mapping[str, DocumentView]:
    """Dims that are divided into bands, or have a unit and a name (``contract.arrays.dims.Dim``). Stages may ask for
    the coordinates of a dim by its name, and for the edges of its bands as ``NAME_edges``.

    {"frequency": {"bins": True, "units": "Hz", "long_name": "frequency"}}
    """


@hookspec
def etendue_units() -> Mapping[str, str]:
    """Units in addition to SI: '' for a base unit, or the definition of one unit in terms of others.

    {"grain": "", "stop": "0.3 grain"}
    """


@hookspec
def etendue_patterns() -> Mapping[str, str]:
    """Generators of fixed patterns (random numbers by absolute position, the same in every cell): the argument of
    ``run`` with which a stage asks for one, and the shared quantity that identifies the owner of the pattern.

    {"rng_film": "film_serial"}
    """


@hookspec
def etendue_commands() -> Mapping[str, DocumentView]:
    """Commands of the program ``etendue``: location of the click command, usage, and a description
    (``cli.commands.Command``).

    {"halation": {"place": "my_film.cli:halation", "usage": "FILE", "doc": "distance from which the base returns
    light"}}
    """


@hookspec
def etendue_methods() -> Mapping[str, str]:
    """Methods of ``etendue.Pipeline`` and ``etendue.Archive``: the location of a function whose first argument is the
    pipeline or archive.

    {"Pipeline.halation": "my_film.study:halation_of"}
    """


@hookspec
def etendue_shares() -> Mapping[str, str]:
    """Attribution of losses to stages: the location of ``function(folder, at, told)``, which returns ``losses`` and
    ``notes``; if it finds no losses, ``why`` states the reason.

    {"halation": "my_film.study:shares_at"}
    """


@hookspec
def etendue_seen() -> Mapping[str, str]:
    """Conversion of arrays to colours. For a dim before y and x, the location of a function of (drawn, edges, names)
    that returns the (3, n) matrix from the n planes along the dim to linear sRGB, or None to show the first three
    planes unchanged. For ``pattern``, the location of a function that receives the text of a pattern and returns its
    rows, and colours by letter.

    {"layer": "my_film.seen:of_layers"}
    """


@hookspec
def etendue_tables() -> Mapping[str, DocumentView]:
    """The name of the table of shared quantities in a pipeline file, and the key that names sets of values in it
    (``contract.values.tables.Table``).

    {"film": {"preset": "stock", "presets": "stocks"}}: ``[film] stock = "NAME"``, provided by ``etendue_stocks()``;
    ``find`` (instead of ``presets``) names a function that returns the path of the file for a given name. ``further``
    adds more keys like ``stock`` to the table; each has its own ``presets``, or its own ``find``
    """


@hookspec
def etendue_templates() -> Mapping[str, DocumentView]:
    """Commented pipelines to start from, for ``etendue new`` (``pipeline.beginning.Template``).

    {"film": {"path": Path(__file__).parent / "film.toml", "keep": {"all": "everything"}}}
    """


@hookspec
def etendue_beginnings() -> Mapping[str, str]:
    """By role, the stage from which ``etendue new-plugin`` starts: the stage whose arithmetic is easiest to read.

    {"halation": "halation_gaussian"}
    """


@hookspec
def etendue_elsewhere() -> Mapping[str, DocumentView]:
    """Stages in other distributions, which are suggested if a pipeline uses them and they are not installed.

    {"my-film-scanner": {"stages": ["scanner_glare"]}}
    """


@hookspec
def etendue_plots() -> Mapping[str, DocumentView]:
    """Kinds of plots: location of ``function(holdings, asked)``, the number of variables, the options it uses
    (``plots.kinds.Kind``).

    It returns a matplotlib figure. ``held = holdings.find("mean_level")`` is a variable, ``held.values()`` its array
    over all axes, and ``held.values(asked.cell(held))`` that of the requested cell; ``asked.figures`` are the names
    that were given.

    {"rose": {"place": "my_weather.plots:rose", "takes": 1, "uses": ["at"], "doc": "how often the wind blows from
    where"}}
    """


@hookspec
def etendue_sections() -> Mapping[str, DocumentView]:
    """Sections of a page: location of ``function(tree)``, and the title. It receives the tree from
    ``etendue.open_archive`` and returns a list of ``{"paragraph": text}``, ``{"table": {"head": [...], "rows": [[...],
    ...]}}`` and ``{"picture": bytes of a PNG, "alt": text}``; an empty list if it has nothing to show.

    {"rain": {"place": "my_weather.page:rain", "title": "How much it rained"}}
    """


@hookspec
def etendue_first() -> Mapping[str, Sequence[str]]:
    """What plots, pages and summaries show first. Names of variables under ``map``, ``sheet``, ``glance``,
    ``headline``, ``curves`` and ``picture``; two names of variables in one text under ``front``; names of axes under
    ``sides`` and ``along``; names of shared quantities under ``quantities``.

    {"map": ["rainfall", "mean_wind"], "front": ["rainfall mean_wind"]}
    """


@hookspec
def etendue_words() -> Mapping[str, str]:
    """Words used in sentences of plots and pages (``contract.wording.WORDS``).

    {"cell": "forecast", "whole": "model"}
    """


@hookspec
def etendue_spelling() -> Mapping[str, str]:
    """Spelling of parts of names on a page; a key that begins with ``_`` matches the end of a name.

    {"rh": "relative humidity"}
    """


@hookspec
def etendue_subjects() -> Mapping[str, DocumentView]:
    """Subjects of metrics, in the order of a page (``contract.wording.Subject``); ``Variable.subject`` names one of
    them.

    {"rain": {"said": "rainfall", "opens": True}}
    """


@hookspec
def etendue_examples() -> DocumentView:
    """Test inputs for stages that look at other stages: ``datasheet`` is the data sheet of an example stage, with a
    role and values.

    {"datasheet": {"role": "gauge", "figures": {"offset": 0.1}}}
    """


@hookspec
def etendue_scales() -> Mapping[str, DocumentView]:
    """Properties of units beyond their size (``contract.wording.Unit``).

    {"hPa": {"full": 1013.0}}
    """
