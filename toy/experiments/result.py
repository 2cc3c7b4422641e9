"""The result of a command: the numbers as text, and the figure."""

from __future__ import annotations

from dataclasses import dataclass

from matplotlib.figure import Figure

__all__ = ["Result"]


@dataclass(frozen=True)
class Result:
    """Text to print and a figure to save.

    Attributes
    ----------
    text : str
        The numbers behind the figure.
    figure : Figure
        The figure.
    """

    text: str
    figure: Figure
