"""How do the toy figures look?

In the colours of :mod:`posecal.plot`, which are the paper's in kind: pink is overconfident, blue is underconfident;
here gold is the truth or the oracle. They stay apart for colour-blind readers. Text is as small as a paper's column
allows.
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
        "figure.constrained_layout.use": True,
    }
    return mpl.rc_context(settings)
