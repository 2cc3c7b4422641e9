"""How are the numbers behind a figure printed? Plain aligned text."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

__all__ = ["check", "table"]


def table(title: str, heads: Sequence[str], rows: Iterable[Sequence[str | float]]) -> str:
    """Align cells in columns: numbers to the right, words to the left.

    Parameters
    ----------
    title : str
        What the table shows.
    heads : sequence of str
        What stands above each column.
    rows : iterable of sequences
        Words as they are, numbers to four digits.

    Returns
    -------
    str
        Several lines.

    Examples
    --------
    >>> print(table("weights", ["hand", "mm", "why"], [["left", 1.25, "light"], ["right", 12, "used"]]))
    weights
      hand     mm  why
      left   1.25  light
      right    12  used
    """
    lines = [list(heads), *([c if isinstance(c, str) else f"{c:.4g}" for c in row] for row in rows)]
    columns = [_aligned(column) for column in zip(*lines, strict=True)]
    return "\n".join([title, *(f"  {'  '.join(line)}".rstrip() for line in zip(*columns, strict=True))])


def _aligned(cells: Sequence[str]) -> list[str]:
    width = max(map(len, cells))
    if all(_is_number(cell) for cell in cells[1:]):
        return [cell.rjust(width) for cell in cells]
    return [cell.ljust(width) for cell in cells]


def _is_number(cell: str) -> bool:
    try:
        float(cell or 0)
    except ValueError:
        return False
    return True


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
