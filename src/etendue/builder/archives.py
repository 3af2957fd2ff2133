"""An archive in Python: what the commands of the same names do with one.

In:  a folder, or the URL of an object store.
Out: trees, plots, files, documents as ``--json`` prints them.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from etendue.archive import places
from etendue.archive.journal import NAME as JOURNAL
from etendue.builder.methods import Extended
from etendue.calls import called_methods
from etendue.present.plots import glance_page
from etendue.present.plots.accessor import TreeAccessor
from etendue.present.plots.glance import Glance, glance, glance_at
from etendue.run.schedulers import check_scheduler
from etendue.session import Options
from etendue.types.documents import Document

if TYPE_CHECKING:
    import xarray

    from etendue.present.plots.accessor import Plots
    from etendue.present.plots.plot import Plot


@called_methods
class Archive(Extended):
    """The archive of a run, at a glance in a notebook, also while a run is writing to it.

    Parameters
    ----------
    place : folder, or URL of an object store such as s3://bucket/name

    Raises
    ------
    ArchiveError
        There is none.

    Examples
    --------
    >>> import etendue
    >>> _ = etendue.simulate("pipelines/smallest.toml", archive="small", want="clipped_fraction")
    >>> archive = etendue.Archive("small")
    >>> float(archive.tree["exposure_report"]["clipped_fraction"].max()) < 1
    True
    >>> archive.verify()["whole"]
    True
    """

    def __init__(self, place: str | Path) -> None:
        self.place = place if places.is_url(place) else Path(place)
        if (
            isinstance(self.place, str) or not (self.place / JOURNAL).is_file()
        ):  # of one that is damaged, what is can be asked
            places.open_archive(self.place).close()

    @property
    def tree(self) -> xarray.DataTree:
        """What is stored, lazily: what is finished by now."""
        return places.open_archive(self.place)

    @property
    def plot(self) -> Plots:
        """``plot()``, ``plot.map(...)``, ``plot.curves(...)``, ``plot.pareto(...)``: as ``etendue plot``."""
        return TreeAccessor(self.tree).plot

    def show(self, variable: str = "", **at: Any) -> Plot:
        """One picture of one cell, upright."""
        return TreeAccessor(self.tree).show(variable, **at)

    def report(self, output: str | Path | None = None, *, blame: bool = False) -> Path:
        """One page to read and send on; ``blame``: also the share of each stage in what is lost, computed now.

        Gives the file that was written; an older one is replaced.
        """
        from etendue.plugins.shares import shares_at
        from etendue.present.page.report import report

        with places.reading(self.place) as folder:
            to = Path(output) if output is not None else Path(f"{folder.resolve().name}-report.html")
            return report(folder, to, shares_at() if blame else None).path

    def verify(self) -> Document:
        """Whether every byte is as it was written, and what is not: what ``etendue verify --json`` prints."""
        from etendue.archive.verify import document, verify

        with places.reading(self.place, exact=True) as folder:
            found: Document = places.named(document(verify(folder)), folder, self.place)
        return found

    def reproduce(self, scheduler: str = "threads", workers: int = 0) -> Document:
        """Compute every cell again from the archive alone and compare, with all else: what
        ``etendue reproduce --json`` prints.
        """
        from etendue.trust.reproducing import document, reproduce

        with places.reading(self.place, exact=True) as folder:
            found: Document = places.named(
                document(reproduce(folder, Options(check_scheduler(scheduler), workers))), folder, self.place
            )
        return found

    def diff(self, other: Archive | str | Path) -> Document:
        """Which cells differ from those of another archive, by how much, and why: what ``etendue diff --json``
        prints.
        """
        from etendue.archive.differences import differences, document

        place = other.place if isinstance(other, Archive) else other
        with places.reading(self.place, inputs=False) as a, places.reading(place, inputs=False) as b:
            found: Document = places.named(places.named(document(a, b, differences(a, b)), a, self.place), b, place)
        return found

    def view(self, height: int = 900) -> Any:
        """A widget with every pixel, sliders and profiles, for notebooks; needs ``pip install 'etendue[view]'``.

        Raises
        ------
        RequestError
            The archive is at an object store, which the command ``etendue view`` fetches.
        """
        from etendue.errors import RequestError
        from etendue.present.page.notebook import view

        if places.is_url(self.place):
            raise RequestError(
                f"{self.place}: a widget shows an archive in a folder; of an object store there is: etendue view "
                f"{self.place}"
            )
        return view(self.place, height)

    def _glance(self) -> Glance:
        return glance(self.tree) if isinstance(self.place, str) else glance_at(self.place)

    def __repr__(self) -> str:
        return glance_page.text(self._glance())

    def _repr_html_(self) -> str:
        return glance_page.page(self._glance())


__all__ = ["Archive"]
