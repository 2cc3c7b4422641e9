"""Colours and settings of the toy figures.

The colours are those of :mod:`posecal.plot`, similar to the paper's: pink is overconfident, blue is underconfident;
here gold is the truth or the oracle. They can be distinguished by colour-blind readers. Text sizes fit a paper's
column.
"""

from __future__ import annotations

from contextlib import AbstractContextManager
from typing import Any

import matplotlib as mpl
from matplotlib.colors import LinearSegmentedColormap

from posecal.plot.style import FAINT, INK, OVER, UNDER

__all__ = ["CONFIDENCE", "DEPTH", "FAINT", "GOLD", "INK", "OVER", "UNDER", "style"]

GOLD = "#E69F00"
CONFIDENCE = LinearSegmentedColormap.from_list("confidence", [OVER, "#FFFFFF", UNDER])
DEPTH = LinearSegmentedColormap.from_list("depth", ["#123A5E", "#5B8DB8", "#F4F1E8"])


def style() -> AbstractContextManager[None]:
    """Return a context manager with the settings of all figures."""
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
        "figure.constrained_layout.use": True,
    }
    return mpl.rc_context(settings)
