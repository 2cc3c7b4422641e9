"""A report in notebooks: tables with a figure, figures by name, and the page within a cell."""

from __future__ import annotations

import base64
import os
import tempfile
import webbrowser
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING

from posecal.errors import PoseDataError, checked_integer
from posecal.plot import draw, figure_bytes

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from posecal.report.report import Report


def plot(
    report: Report,
    kind: str = "reliability",
    *,
    title: str | None = None,
    size: tuple[float, float] | None = None,
    style: str | os.PathLike[str] | None = None,
) -> Figure:
    """Draw the report, as :func:`posecal.plot.draw` does.

    Parameters
    ----------
    kind : str
        A key of ``posecal.plot.KINDS``: ``reliability``, ``joints``, ``errors``, ``pck``, ``sparsification``,
        ``risk_coverage``, ``event``, ``rank_tests`` or ``horizon``.
    title, size, style
        As for :func:`posecal.plot.draw`.

    Returns
    -------
    matplotlib Figure
        Notebooks show it.

    Raises
    ------
    PoseDataError
        Where the report lacks what the picture shows, and for another kind.
    """
    return draw(report, kind, title=title, size=size, style=style)


def view(report: Report, *, height: int = 800) -> PageView:
    """Give the page of ``posecal evaluate --html``, with the poses that the report keeps.

    Parameters
    ----------
    height : int
        Of the page within a notebook, pixels.

    Returns
    -------
    PageView
        Notebooks show it; elsewhere its method ``open`` shows it in a browser.
    """
    from posecal.report.html import as_html

    return PageView(as_html(report, "report"), checked_integer(height, "height", 1))


class PageView:
    """A page that notebooks show.

    Parameters
    ----------
    page : str
        HTML.
    height : int
        Pixels.
    """

    def __init__(self, page: str, height: int) -> None:
        self.page, self.height = page, height

    def __repr__(self) -> str:
        return f"<posecal page, {len(self.page) // 1000:,} kB; .open() shows it in a browser>"

    def _repr_html_(self) -> str:
        style = f"width:100%;height:{self.height}px;border:1px solid #ccc"
        return f'<iframe title="posecal report" style="{style}" srcdoc="{escape(self.page)}"></iframe>'

    def open(self) -> None:
        """Write the page into a temporary file and show it in the browser."""
        with tempfile.NamedTemporaryFile("w", suffix=".html", delete=False, encoding="utf-8") as file:
            file.write(self.page)
        webbrowser.open(Path(file.name).as_uri())


def fragment(report: Report) -> str:
    """Write sentences, remarks and tables, with the reliability diagram, as the part of a page that notebooks show."""
    from posecal.report.html import render
    from posecal.report.text import report_sheet

    try:
        picture = base64.b64encode(figure_bytes(draw(report), ".png")).decode()
    except PoseDataError:  # the report has no curves
        picture = ""
    return render("fragment.html", sheet=report_sheet(report), picture=picture)
