"""Colours and fonts of pictures, and how they are written into files, without a display.

The colours tell over- from underconfidence for colour-blind readers too.
"""

from __future__ import annotations

import io
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

from posecal.data.write import write_file
from posecal.errors import PoseFileError, printable

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

UNDER, OVER, INK, FAINT = "#0072B2", "#CC79A7", "#222222", "#B8B8B8"
"""Underconfident; overconfident; text and main lines; lines in the background."""

OVER_TEXT, ORANGE, GREEN = "#9C4A78", "#D55E00", "#009E73"
"""Overconfident as text, and two more lines."""

SUFFIXES = (".svg", ".png", ".pdf")

STYLE: dict[Any, Any] = {
    "font.family": "DejaVu Sans",
    "font.size": 8.5,
    "axes.labelsize": 9,
    "axes.titlesize": 9.5,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": INK,
    "axes.labelcolor": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "text.color": INK,
    "legend.frameon": False,
    "text.parse_math": False,
    "figure.dpi": 110,
    "savefig.dpi": 200,
    "svg.fonttype": "none",
    "svg.hashsalt": "posecal",
    "pdf.fonttype": 42,
}


def given(ax: Axes | None) -> Axes:
    """Give the axes to draw on: those that were passed, or the current ones."""
    if ax is not None:
        return ax
    from matplotlib import pyplot as plt

    return plt.gca()


def save(figure: Figure, path: str | os.PathLike[str]) -> None:
    """Write a figure into a file, all of it or nothing.

    Parameters
    ----------
    figure : matplotlib Figure
        What is written.
    path : path
        Ends with ``.svg``, ``.png`` or ``.pdf``.

    Raises
    ------
    PoseFileError
        For another ending, or where the file can't be written.
    """
    contents = figure_bytes(figure, check_suffix(path))
    write_file(path, lambda file: file.write(contents))


def figure_bytes(figure: Figure, suffix: str) -> bytes:
    """Give the contents of a picture file, the same for the same figure; what can't be shown of its text is escaped."""
    import matplotlib as mpl
    from matplotlib.text import Text

    for artist in figure.findobj():
        artist.set_gid(printable(artist.get_gid() or "") or None)
        if isinstance(artist, Text):
            artist.set_text("\n".join(map(printable, artist.get_text().split("\n"))))
    undated = {".svg": {"Date": None}, ".pdf": {"CreationDate": None}}.get(suffix, {})
    file = io.BytesIO()
    with mpl.rc_context(STYLE):
        figure.savefig(file, format=suffix[1:], metadata=undated)
    return file.getvalue()


def check_suffix(path: str | os.PathLike[str]) -> str:
    """Give the ending of a picture's name.

    Raises
    ------
    PoseFileError
        Where it is no picture that can be drawn.
    """
    suffix = Path(path).suffix.lower()
    if suffix not in SUFFIXES:
        raise PoseFileError(f"{path}: {suffix or 'no ending'}; expected a name that ends with .svg, .png or .pdf.")
    return suffix
