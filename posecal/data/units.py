"""Units of length, converted into millimetres once, when poses are read.

A unit is one of ``mm``, ``cm``, ``m``, or the length of one unit in millimetres as a number or a fraction
of two, for data that were scaled: poses multiplied by 0.0036 per millimetre have the unit ``1/0.0036``.
"""

from __future__ import annotations

import math

from posecal.errors import PoseDataError

MILLIMETRES = {"mm": 1.0, "cm": 10.0, "m": 1000.0}
"""Millimetres in one of each named unit."""


def millimetres_per(unit: str | float) -> float:
    """Give the factor that turns a length in ``unit`` into millimetres.

    Parameters
    ----------
    unit : str or float
        ``mm``, ``cm``, ``m``, a positive number, or a fraction ``a/b`` of two.

    Returns
    -------
    float
        Millimetres per unit, positive and finite.

    Raises
    ------
    PoseDataError
        For any other text.

    Notes
    -----
    Differs from the published code: none.

    Examples
    --------
    >>> millimetres_per("m")
    1000.0
    >>> millimetres_per("1/0.5")
    2.0
    >>> millimetres_per("inch")
    Traceback (most recent call last):
    posecal.errors.PoseDataError: unit: 'inch'; expected mm, cm, m, or the millimetres in one unit...
    """
    text = str(unit)
    named = MILLIMETRES.get(text.strip().lower())
    if named is not None:
        return named
    over, _, under = text.partition("/")
    try:
        factor = float(over) / float(under or 1)
    except (ValueError, ZeroDivisionError):
        factor = math.nan
    if not (0 < factor < math.inf):
        raise PoseDataError(
            f"unit: {unit!r}; expected mm, cm, m, or the millimetres in one unit as a number (25.4) "
            "or fraction (1/0.0036)."
        )
    return factor
