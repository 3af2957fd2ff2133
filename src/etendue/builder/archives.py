"""An archive in Python: its methods correspond to the commands of the same names.

In:  a folder, or the URL of an object store.
Out: trees, plots, files, and documents as printed by ``--json``.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from etendue.archive import places
from etendue.archive.checks import verify as verifying
from etendue.archive.journaling.journal import NAME as JOURNAL
from etendue.archive.read import differences
from etendue.builder.methods import Extended
from etendue.calls import called_methods
from etendue.errors import RequestError
from etendue.plugins.shares import shares_at
from etendue.present.page import notebook
from etendue.present.page import report as report_page
from etendue.present.plots.accessor import TreeAccessor
from etendue.present.plots.summary import page
from etendue.present.plots.summary.contents import Glance, glance, glance_at
from etendue.run.schedulers import check_scheduler
from etendue.session import Options
from etendue.trust import reproducing
from etendue.types.documents import Document

if TYPE_CHECKING:
    import xarray

    from etendue.present.plots.accessor import Plots
    from etendue.present.plots.plot import Plot


@called_methods
class Archive(Extended):
    """The archive of a run. A notebook shows its summary, also while a run is still writing to it.

    Parameters
    ----------
    place : folder, or URL of an object store such as s3://bucket/name

    Raises
    ------
    ArchiveError
        If there is no archive.

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
        ):  # a damaged archive can still be examined
            places.open_archive(self.place).close()

    @property
    def tree(self) -> xarray.DataTree:
        """The results that are finished so far, loaded lazily."""
        return places.open_archive(self.place)

    @property
    def plot(self) -> Plots:
        """``plot()``, ``plot.map(...)``, ``plot.curves(...)``, ``plot.pareto(...)``, as in ``etendue plot``."""
        return TreeAccessor(self.tree).plot

    def show(self, variable: str = "", **at: Any) -> Plot:
        """Return one picture of one cell, upright."""
        return TreeAccessor(self.tree).show(variable, **at)

    def report(self, output: str | Path | None = None, *, blame: bool = False) -> Path:
        """Write a report as one page, and return its path; an existing file is replaced.

        ``blame``: also compute each stage's share of the losses now.
        """
        with places.reading(self.place) as folder:
            to = Path(output) if output is not None else Path(f"{folder.resolve().name}-report.html")
            return report_page.report(folder, to, shares_at() if blame else None).path

    def verify(self) -> Document:
        """Check that every byte is as written; return the document that ``etendue verify --json`` prints."""
        with places.reading(self.place, exact=True) as folder:
            found: Document = places.named(verifying.document(verifying.verify(folder)), folder, self.place)
        return found

    def reproduce(self, scheduler: str = "threads", workers: int = 0) -> Document:
        """Compute every cell again from the archive alone and compare.

        Return the document that ``etendue reproduce --json`` prints.
        """
        with places.reading(self.place, exact=True) as folder:
            found: Document = places.named(
                reproducing.document(reproducing.reproduce(folder, Options(check_scheduler(scheduler), workers))),
                folder,
                self.place,
            )
        return found

    def diff(self, other: Archive | str | Path) -> Document:
        """Compare with another archive: find the differing cells, and the size and cause of each difference. Return the
        document that ``etendue diff --json`` prints.
        """
        place = other.place if isinstance(other, Archive) else other
        with places.reading(self.place, inputs=False) as a, places.reading(place, inputs=False) as b:
            found: Document = places.named(
                places.named(differences.document(a, b, differences.differences(a, b)), a, self.place), b, place
            )
        return found

    def view(self, height: int = 900) -> Any:
        """Return a widget with every pixel, sliders and profiles, for notebooks; needs ``pip install 'etendue[view]'``.

        Raises
        ------
        RequestError
            If the archive is in an object store; use the command ``etendue view``, which fetches the archive.
        """
        if places.is_url(self.place):
            raise RequestError(
                f"{self.place}: the widget needs an archive in a local folder; for an object store run: etendue view "
                f"{self.place}"
            )
        return notebook.view(self.place, height)

    def _glance(self) -> Glance:
        return glance(self.tree) if isinstance(self.place, str) else glance_at(self.place)

    def __repr__(self) -> str:
        return page.text(self._glance())

    def _repr_html_(self) -> str:
        return page.page(self._glance())


__all__ = ["Archive"]
