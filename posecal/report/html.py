"""A report as one self-contained page with tables and pictures, and as the part of it that notebooks show.

Everything that comes from files is escaped, control characters too; pictures are inline vector graphics.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from importlib.resources import files
from typing import TYPE_CHECKING

from posecal.data.write import write_file
from posecal.errors import PoseDataError, for_python, printable
from posecal.plot import KINDS, OWN_PANELS, caption_of, draw, figure_bytes
from posecal.report.text import report_sheet

if TYPE_CHECKING:
    from posecal.report.report import Report


def as_html(report: Report, name: str, words: Callable[[str], str] = for_python) -> str:
    """Write a report as one page.

    Parameters
    ----------
    report : Report
        The numbers.
    name : str
        What the page calls the hypotheses.
    words : callable
        How remarks name options: ``for_python`` or ``for_command_line`` of :mod:`posecal.errors`.

    Returns
    -------
    str
        HTML that needs no other file.
    """
    pictures = []
    for kind, (_, about) in KINDS.items():
        try:
            figure = draw(report, kind)
        except PoseDataError:
            continue  # the report lacks what the picture shows
        said = caption_of(figure).partition("\nsignature:")[0]  # which stands at the end of the page
        figure.set_label("")
        svg = figure_bytes(figure, ".svg").decode()
        pictures.append((about, _with_unique_ids(svg[svg.index("<svg") :], kind), kind in OWN_PANELS, said))
    return _render(report, words, name=printable(name), pictures=pictures)


def html_fragment(report: Report) -> str:
    """Write sentences, remarks and tables of a report as the part of a page that notebooks show."""
    return _render(report)


def _render(report: Report, words: Callable[[str], str] = for_python, **page: object) -> str:
    from jinja2 import Environment

    template = files("posecal.report").joinpath("page.html").read_text(encoding="utf-8")
    sheet = report_sheet(report, all=bool(page), joints=bool(page), definitions=bool(page), words=words)
    environment = Environment(autoescape=True, trim_blocks=True, lstrip_blocks=True)
    return environment.from_string(template).render(sheet=sheet, **page)


def _with_unique_ids(svg: str, kind: str) -> str:
    """Drop unused ids of a picture and prefix the rest, so that ids are unique in the page."""
    used = set(re.findall(r'(?:href="|url\()#([^")]+)', svg))
    named = re.sub(r' id="([^"]*)"', lambda match: f' id="{kind}-{match[1]}"' if match[1] in used else "", svg)
    return re.sub(r'(href="|url\()#', rf"\g<1>#{kind}-", named)


def write_html(report: Report, path: str | os.PathLike[str], name: str) -> None:
    """Write :func:`as_html` into a file, all of it or nothing.

    Raises
    ------
    PoseFileError
        Where the file can't be written.
    """
    page = as_html(report, name).encode()
    write_file(path, lambda file: file.write(page))
