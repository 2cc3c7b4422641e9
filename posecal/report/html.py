"""A report as one self-contained page: numbers that can be sorted, diagrams that name their joints, poses to turn.

Everything that comes from files is escaped, control characters too. A policy within the page keeps the browser from any
request, and from scripts other than the page's own.
"""

from __future__ import annotations

import base64
import hashlib
import os
import re
from collections.abc import Callable
from importlib.resources import files
from typing import TYPE_CHECKING

from posecal.data.write import write_file
from posecal.errors import PoseDataError, for_python, printable
from posecal.plot import KINDS, OWN_PANELS, caption_of, draw, figure_bytes
from posecal.report.page_data import diagrams, poses_json
from posecal.report.page_tables import joint_table, label_table, metric_table, sequence_table
from posecal.report.summary import remarks
from posecal.report.text import report_title

if TYPE_CHECKING:
    from posecal.report.report import Report

SCRIPTS = "page.js", "poses.js"

COLOURS = {
    "#222222": "var(--ink)",
    "#444444": "var(--soft)",
    "#666666": "var(--soft)",
    "#777777": "var(--soft)",
    "#b8b8b8": "var(--faint)",
    "#e4e4e4": "var(--line)",
    "#ffffff": "var(--paper)",
}
"""Colours of pictures that follow those of the page, light or dark."""


def as_html(
    report: Report,
    name: str,
    words: Callable[[str], str] = for_python,
    *,
    gallery: bool = True,
    command: str = "",
) -> str:
    """Write a report as one page.

    Parameters
    ----------
    report : Report
        The numbers.
    name : str
        What the page calls the hypotheses.
    words : callable
        How remarks name options: ``for_python`` or ``for_command_line`` of :mod:`posecal.errors`.
    gallery : bool
        Whether the poses that the report keeps are shown.
    command : str
        What makes the page again.

    Returns
    -------
    str
        HTML that needs no other file.
    """
    poses = poses_json(report) if gallery else ""
    scripts = "".join(map(_source, SCRIPTS if poses else SCRIPTS[:1]))
    tables = [
        ("metrics", metric_table(report)),
        *((f"group-{number}", label_table(report, label)) for number, label in enumerate(report.by)),
        ("joints", joint_table(report)),
    ]
    shown = report.headline_metrics.values()
    return render(
        "page.html",
        name=name,
        title=report_title(report),
        sentences=report.summary,
        remarks=remarks(report, words),
        diagrams=diagrams(report),
        poses=poses,
        holds_no_poses=report.totals.gallery is None,
        sequences=sequence_table(report),
        tables=[(anchor, table) for anchor, table in tables if table is not None],
        pictures=_pictures(report),
        definitions=[(metric.label, metric.definition) for metric in shown],
        signature=report.signature,
        command=command,
        style=_source("page.css"),
        script=scripts,
        script_hash=base64.b64encode(hashlib.sha256(scripts.encode()).digest()).decode(),
    )


def render(template: str, **parts: object) -> str:
    """Fill a template of this package; what is put in is escaped, and what can't be shown of it."""
    from jinja2 import Environment, FunctionLoader

    environment = Environment(
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        loader=FunctionLoader(_source),
        finalize=lambda value: printable(value) if type(value) is str else value,  # not of what is marked as safe
    )
    return environment.get_template(template).render(**parts)


def _source(name: str) -> str:
    return files("posecal.report").joinpath(name).read_text(encoding="utf-8")


def _pictures(report: Report) -> dict[str, list[tuple[str, str, str]]]:
    """Draw the figures that the report can have, but the reliability diagram: words and SVG, by where they stand."""
    pictures: dict[str, list[tuple[str, str, str]]] = {"joints": [], "others": [], "wide": []}
    for kind, (_, about) in KINDS.items():
        if kind == "reliability":
            continue
        try:
            figure = draw(report, kind)
        except PoseDataError:
            continue  # the report lacks what the picture shows
        said = caption_of(figure).partition("\nsignature:")[0]  # which stands at the end of the page
        figure.set_label("")
        svg = figure_bytes(figure, ".svg").decode()
        svg = _with_unique_ids(svg[svg.index("<svg") :], kind)
        for colour, variable in COLOURS.items():
            svg = svg.replace(f": {colour}", f": {variable}")
        place = "joints" if kind == "joints" else "wide" if kind in OWN_PANELS else "others"
        pictures[place].append((about, svg, said))
    return pictures


def _with_unique_ids(svg: str, kind: str) -> str:
    """Drop unused ids of a picture and prefix the rest, so that ids are unique in the page."""
    used = set(re.findall(r'(?:href="|url\()#([^")]+)', svg))
    named = re.sub(r' id="([^"]*)"', lambda match: f' id="{kind}-{match[1]}"' if match[1] in used else "", svg)
    return re.sub(r'(href="|url\()#', rf"\g<1>#{kind}-", named)


def write_html(report: Report, path: str | os.PathLike[str], name: str, *, gallery: bool = True) -> None:
    """Write :func:`as_html` into a file, all of it or nothing.

    Raises
    ------
    PoseFileError
        Where the file can't be written.
    """
    page = as_html(report, name, gallery=gallery).encode()
    write_file(path, lambda file: file.write(page))
