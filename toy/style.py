"""How do the toy figures look, and how are they saved?

Pink is overconfident, blue is underconfident, gold is the truth or the oracle, as in the paper; the three stay
apart for colour-blind readers and in grey. Text is as small as a paper's column allows.
"""

from __future__ import annotations

from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure

from toy.whole_file import whole_file

__all__ = ["BLUE", "CONFIDENCE", "DEPTH", "FORMATS", "GOLD", "GREY", "INK", "PINK", "save", "style"]

FORMATS = (".svg", ".png", ".pdf")
PINK, BLUE, GOLD, INK, GREY = "#D81B60", "#1E88E5", "#EDAC32", "#222222", "#8A8A8A"
CONFIDENCE = LinearSegmentedColormap.from_list("confidence", [PINK, "#FFFFFF", BLUE])
DEPTH = LinearSegmentedColormap.from_list("depth", ["#123A5E", "#5B8DB8", "#F4F1E8"])


def style() -> AbstractContextManager[None]:
    """Give the settings that all figures share, for a ``with``."""
    settings: Any = {
        "font.size": 8,
        "axes.titlesize": 8,
        "axes.spines.top": False,
        "axes.spines.right": False,
        "axes.linewidth": 0.6,
        "xtick.major.width": 0.6,
        "ytick.major.width": 0.6,
        "lines.linewidth": 1.2,
        "legend.frameon": False,
        "legend.fontsize": 7,
        "figure.dpi": 150,
        "figure.constrained_layout.use": True,
        "svg.fonttype": "none",
        "svg.hashsalt": "toy",
    }
    return mpl.rc_context(settings)


def save(figure: Figure, path: Path) -> None:
    """Write a figure whole or not at all.

    Parameters
    ----------
    figure : Figure
        What to write.
    path : Path
        Where to; its ending, one of :data:`FORMATS`, says in which format.

    Raises
    ------
    PoseFileError
        Where the folder is not there or can't be written to.
    """
    dates: dict[str, dict[str, Any]] = {".svg": {"Date": None}, ".pdf": {"CreationDate": None}, ".png": {}}
    with style(), whole_file(path) as part:
        figure.savefig(part, metadata=dates[path.suffix.lower()])
