"""Formatting of numbers as aligned text."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

__all__ = ["check", "table"]


def table(title: str, heads: Sequence[str], rows: Iterable[Sequence[str | float]]) -> str:
    """Format a table: numbers aligned to the right, text to the left.

    Parameters
    ----------
    title : str
        Title of the table.
    heads : sequence of str
        Column heads.
    rows : iterable of sequences
        Text unchanged, numbers with four digits.

    Returns
    -------
    str
        Title, heads and rows, a line each.

    Examples
    --------
    >>> print(table("weights", ["hand", "mm", "why"], [["left", 1.25, "light"], ["right", 12, "used"]]))
    weights
      hand     mm  why
      left   1.25  light
      right    12  used
    """
    lines = [list(heads), *([c if isinstance(c, str) else f"{c:.4g}" for c in row] for row in rows)]
    columns = [_align(column) for column in zip(*lines, strict=True)]
    return "\n".join([title, *(f"  {'  '.join(line)}".rstrip() for line in zip(*columns, strict=True))])


def _align(cells: Sequence[str]) -> list[str]:
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


def check(quantity: str, exact: float, simulated: tuple[float, float]) -> str:
    """Format the comparison of a simulated value with the exact one.

    Parameters
    ----------
    quantity : str
        Name of the quantity.
    exact : float
        Its exact value.
    simulated : tuple of float
        Mean and standard error of a simulation.

    Returns
    -------
    str
        One line, with the difference in standard errors.

    Examples
    --------
    >>> check("minMPJPE", 3.0, (3.02, 0.01))
    'check: minMPJPE: exact 3, simulated 3.02 ± 0.01 (+2.0 standard errors)'
    """
    mean, error = simulated
    difference = f"{(mean - exact) / error:+.1f} standard errors"
    return f"check: {quantity}: exact {exact:.6g}, simulated {mean:.6g} ± {error:.1g} ({difference})"
