"""Units, converted once, when poses are read: lengths into millimetres, angles into degrees.

A length has the unit ``mm``, ``cm``, ``m``, or the millimetres in one unit as a number or a fraction of two, for data
that were scaled: poses multiplied by 0.0036 per millimetre have the unit ``1/0.0036``. An angle has the unit ``deg`` or
``rad``; all else is in ``px``, or has no unit (``none``).
"""

from __future__ import annotations

import math

from posecal.errors import PoseDataError

MILLIMETRES = {"mm": 1.0, "cm": 10.0, "m": 1000.0}
"""Millimetres in one of each named unit."""


OTHERS = {"deg": ("deg", 1.0), "rad": ("deg", math.degrees(1)), "px": ("px", 1.0), "none": ("", 1.0)}
"""Units of what is no length: the one that is printed, and how many of it are in one."""

PERIODS = {"deg": 360.0}
"""The printed units of quantities that repeat, and after how much they do."""


def quantity(unit: str | float) -> tuple[str, float]:
    """Give the unit in which a quantity is measured and printed, and how many of it are in one of ``unit``.

    Parameters
    ----------
    unit : str or float
        ``deg``, ``rad``, ``px``, ``none``, or a length as for :func:`millimetres_per`.

    Returns
    -------
    unit : str
        ``mm``, ``deg``, ``px``, or empty.
    factor : float
        By which stored numbers are multiplied.

    Raises
    ------
    PoseDataError
        For any other text.

    Examples
    --------
    >>> quantity("m"), quantity("deg"), quantity("none")
    (('mm', 1000.0), ('deg', 1.0), ('', 1.0))
    """
    return OTHERS.get(str(unit).strip().lower()) or ("mm", millimetres_per(unit))


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
            "or fraction (1/0.0036); deg, rad, px or none for what is no length."
        )
    return factor
