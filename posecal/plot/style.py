"""Colours, fonts and sizes of figures, and how they are written into files, without a display.

The colours tell over- from underconfidence for colour-blind readers too.
"""

from __future__ import annotations

import io
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from posecal.data.write import write_file, written_together
from posecal.errors import PoseDataError, PoseFileError, did_you_mean, printable

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

UNDER, OVER, INK, FAINT = "#0072B2", "#CC79A7", "#222222", "#B8B8B8"
"""Underconfident; overconfident; text and main lines; lines in the background."""

OVER_TEXT, ORANGE, GREEN = "#9C4A78", "#D55E00", "#009E73"
"""Overconfident as text, and two more lines."""

MODEL_COLOURS = (UNDER, ORANGE, GREEN, "#CC79A7", "#E69F00", "#56B4E9", "#6B6B6B")
"""Colours of several models in one figure (Okabe and Ito's), which colour-blind readers can tell apart."""

MOST_INCHES = 40
"""The largest width and height of a figure."""

SUFFIXES = (".svg", ".png", ".pdf")

STYLE: dict[Any, Any] = {
    "font.family": "sans-serif",
    "font.sans-serif": ["DejaVu Sans", "Verdana", "sans-serif"],  # Verdana is as wide, where an SVG finds no DejaVu
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
    "axes.prop_cycle": f"cycler('color', {list(MODEL_COLOURS)})",
    "legend.frameon": False,
    "legend.fontsize": "small",
    "figure.dpi": 110,
    "figure.titlesize": 9.5,
    "savefig.dpi": 200,
}

FIXED: dict[Any, Any] = {
    "text.parse_math": False,  # names from files are no formulas
    "text.usetex": False,
    "svg.fonttype": "none",
    "svg.hashsalt": "posecal",
    "pdf.fonttype": 42,
}
"""What no style of a user changes."""


def ink() -> str:
    """Give the colour of text and main lines in the style in use."""
    import matplotlib as mpl

    return str(mpl.rcParams["text.color"])


def check_size(size: tuple[float, float] | None) -> None:
    """Refuse a size that no figure can have.

    Raises
    ------
    PoseDataError
        With what is possible.
    """
    if size is not None and not all(0 < inches <= MOST_INCHES for inches in size):
        raise PoseDataError(f"size: {size}; expected inches across and down, above 0 and at most {MOST_INCHES}.")


def style_parameters(style: str | os.PathLike[str] | None) -> Mapping[str, Any]:
    """Give the parameters of a style of Matplotlib, by its name or from an ``.mplstyle`` file.

    Raises
    ------
    PoseDataError
        Where it is neither.
    PoseFileError
        Where the file can't be read.
    """
    if style is None:
        return {}
    from matplotlib import rc_params_from_file
    from matplotlib.style import available, library

    found: Any
    if str(style) in available:
        found = library[str(style)]
        return dict(found)
    if not Path(style).is_file():
        raise PoseDataError(
            f"style: {str(style)!r} is neither a file nor a style of Matplotlib. {did_you_mean(str(style), available)}"
        )
    try:
        found = rc_params_from_file(style, use_default_template=False)
        return dict(found)
    except (OSError, ValueError) as error:
        raise PoseFileError(f"{style}: no style file of Matplotlib ({error}).") from None


@contextmanager
def new_figure(
    size: tuple[float, float],
    style: str | os.PathLike[str] | None = None,
    title: str | None = None,
    *,
    layout: Any = "constrained",
) -> Iterator[Figure]:
    """Make a figure in posecal's style, changed by another one, and finish it at the end.

    Raises
    ------
    PoseDataError, PoseFileError
        As :func:`check_size` and :func:`style_parameters` do.
    """
    import matplotlib as mpl

    from posecal.plot.shown_figure import ShownFigure

    check_size(size)
    changes = style_parameters(style)
    with mpl.rc_context(STYLE):
        mpl.rcParams.update({name: value for name, value in changes.items() if not name.startswith("backend")} | FIXED)
        figure = ShownFigure(figsize=size, layout=layout)
        if title:
            figure.suptitle(printable(title))
        yield figure
        if changes:
            figure.draw_without_rendering()  # ticks take their style when they are first drawn


def given(ax: Axes | None) -> Axes:
    """Give the axes to draw on: those that were passed, or the current ones."""
    if ax is not None:
        return ax
    from matplotlib import pyplot as plt

    return plt.gca()


def save(figure: Figure, path: str | os.PathLike[str]) -> None:
    """Write a figure into a file and its caption into a text file beside it, both or neither.

    Parameters
    ----------
    figure : matplotlib Figure
        What is written. Its label is the caption, which ``draw`` and its kin set; without one there is no text file.
    path : path
        Ends with ``.svg``, ``.png`` or ``.pdf``. The caption's name is this one and ``.txt``.

    Raises
    ------
    PoseFileError
        For another ending, or where the file can't be written.
    """
    contents = figure_bytes(figure, check_suffix(path))
    with written_together():
        write_file(path, lambda file: file.write(contents))
        if words := caption_of(figure):
            write_file(f"{os.fspath(path)}.txt", lambda file: file.write(f"{words}\n".encode()))


def caption_of(figure: Figure) -> str:
    """Give the caption of a figure: what it shows, numbers with their definitions, and the signature."""
    return "\n".join(map(printable, str(figure.get_label()).split("\n")))


def figure_bytes(figure: Figure, suffix: str) -> bytes:
    """Give the contents of a picture file, the same for the same figure; what can't be shown of its text is escaped."""
    import matplotlib as mpl
    from matplotlib.text import Text

    for artist in figure.findobj():
        artist.set_gid(printable(artist.get_gid() or "") or None)
        if isinstance(artist, Text):
            artist.set_text("\n".join(map(printable, artist.get_text().split("\n"))))
    undated = {".svg": {"Date": None}, ".pdf": {"CreationDate": None}}.get(suffix, {})
    about = {"Subject" if suffix == ".pdf" else "Description": caption_of(figure) or None}
    file = io.BytesIO()
    with mpl.rc_context(STYLE | FIXED):
        figure.savefig(file, format=suffix[1:], metadata={k: v for k, v in about.items() if v} | undated)
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
