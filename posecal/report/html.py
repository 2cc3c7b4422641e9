"""How does a report look in a browser? One self-contained page with the tables and the pictures.

Everything that comes from files is escaped; pictures are inline vector graphics.
"""

from __future__ import annotations

import os
import re
from importlib.resources import files

from posecal.data.write import write_file
from posecal.errors import PoseDataError
from posecal.plot import KINDS, draw, figure_bytes
from posecal.report.report import Report
from posecal.report.sheets import report_sheet

__all__ = ["as_html", "write_html"]


def as_html(report: Report, name: str) -> str:
    """Write a report as one page.

    Parameters
    ----------
    report : Report
        The numbers.
    name : str
        What the page calls the hypotheses.

    Returns
    -------
    str
        HTML that needs no other file.
    """
    from jinja2 import Environment

    pictures = []
    for kind, (_, about) in {**KINDS, "rank_tests": (None, "tests for what the ECE can't see")}.items():
        try:
            svg = figure_bytes(draw(report, kind), ".svg").decode()
        except PoseDataError:
            continue  # the report lacks what the picture shows
        pictures.append((about, _named_apart(svg[svg.index("<svg") :], kind), kind == "rank_tests"))
    template = files("posecal.report").joinpath("page.html").read_text(encoding="utf-8")
    page = Environment(autoescape=True, trim_blocks=True).from_string(template)
    sheet = report_sheet(report, joints=True, definitions=True)
    return page.render(name=name, sheet=sheet, remarks=report.remarks, pictures=pictures)


def _named_apart(svg: str, kind: str) -> str:
    """Leave names only to the parts that a picture refers to, and none that another picture of the page has."""
    used = set(re.findall(r'(?:href="|url\()#([^")]+)', svg))
    named = re.sub(r' id="([^"]*)"', lambda found: f' id="{kind}-{found[1]}"' if found[1] in used else "", svg)
    return re.sub(r'(href="|url\()#', rf"\g<1>#{kind}-", named)


def write_html(report: Report, path: str | os.PathLike[str], name: str) -> None:
    """Write :func:`as_html` into a file, whole or not at all.

    Raises
    ------
    PoseFileError
        Where the file can't be written.
    """
    page = as_html(report, name).encode()
    write_file(path, lambda file: file.write(page))
