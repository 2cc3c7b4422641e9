"""How are the numbers behind a figure printed? Plain aligned text."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

__all__ = ["check", "table"]


def table(title: str, heads: Sequence[str], rows: Iterable[Sequence[str | float]]) -> str:
    """Align cells in columns, the first to the left and the others to the right.

    Parameters
    ----------
    title : str
        What the table shows.
    heads : sequence of str
        What stands above each column.
    rows : iterable of sequences
        Words as they are, numbers to five digits.

    Returns
    -------
    str
        Several lines.

    Examples
    --------
    >>> print(table("weights", ["", "mm"], [["left", 1.25], ["right", 12]]))
    weights
             mm
      left   1.25
      right    12
    """
    lines = [list(heads), *([c if isinstance(c, str) else f"{c:.5g}" for c in row] for row in rows)]
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    aligned = (
        "  ".join([line[0].ljust(widths[0]), *(c.rjust(w) for c, w in zip(line[1:], widths[1:], strict=True))])
        for line in lines
    )
    return "\n".join([title, *(f"  {line}".rstrip() for line in aligned)])


def check(what: str, exact: float, simulated: tuple[float, float]) -> str:
    """Put a simulated value beside the exact one.

    Parameters
    ----------
    what : str
        The quantity.
    exact : float
        Its exact value.
    simulated : tuple of float
        Mean and standard error of a simulation.

    Returns
    -------
    str
        One line, with how many standard errors lie between the two.

    Examples
    --------
    >>> check("minMPJPE", 3.0, (3.02, 0.01))
    'check: minMPJPE: exact 3, simulated 3.02 ± 0.01 (+2.0 standard errors)'
    """
    mean, error = simulated
    away = f"{(mean - exact) / error:+.1f} standard errors"
    return f"check: {what}: exact {exact:.6g}, simulated {mean:.6g} ± {error:.1g} ({away})"
