"""Hypotheses and truth as functions of arrays take them: layout, unit, shapes and mask, checked in one place."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

import numpy as np

from posecal.data.arrays import BoolArray, FloatArray, checked_mask, real_array
from posecal.data.checks import refuse_tiny
from posecal.data.declarations import choose_layouts, refuse_ambiguous
from posecal.data.degenerate import is_one_point, refuse_one_point
from posecal.data.fitted_poses import FEWEST_COORDINATES
from posecal.data.layout import HYPOTHESES, Layout, MemoryArray, plausible_layouts
from posecal.data.stored_poses import StoredPoses, in_millimetres
from posecal.data.units import PERIODS, quantity
from posecal.errors import PoseDataError, option

_MOST_POINTS = 0.5
"""Where so many true poses are one point, as in worked examples, they are meant."""

_DECLARED: ContextVar[str | None] = ContextVar("declared", default=None)


@contextmanager
def declared(unit: str = "mm") -> Iterator[None]:
    """Take arrays as (N, M, K, D) in a unit: blocks of poses that were read so, passed on to a user's function."""
    token = _DECLARED.set(unit)
    try:
        yield
    finally:
        _DECLARED.reset(token)


def quantity_of(unit: str | float | None) -> tuple[str, float]:
    """Give the unit in which arrays are measured, and the factor of their numbers; of no unit that of the context."""
    return quantity(_DECLARED.get() or "mm" if unit is None else unit)


def period_of(unit: str | float | None) -> float | None:
    """Give after how much the coordinates of arrays repeat; None where they don't."""
    return PERIODS.get(quantity_of(unit)[0])


def any_unit(unit: str | float | None) -> str | float:
    """Give the unit of arrays whose lengths may be in any: the declared one, that of the context, or none."""
    return (_DECLARED.get() or "none") if unit is None else unit


def refuse_all_but_lengths(unit: str | float | None, what: str) -> None:
    """Refuse arrays that are no lengths, where something is given in mm.

    Raises
    ------
    PoseDataError
        With what it is.
    """
    measured = quantity_of(unit)[0]
    if measured != "mm":
        raise PoseDataError(f"{what}, but the data are {measured or 'no unit'}; expected lengths.")


def checked(
    hypotheses: object,
    truth: object,
    where: object = None,
    *,
    axes: str | None = None,
    unit: str | float | None = None,
) -> tuple[FloatArray, FloatArray, BoolArray | None]:
    """Check two arrays and the mask, in the paper's layout and in millimetres, degrees, pixels or no unit.

    Parameters
    ----------
    hypotheses : array_like (N, M, K, D)
        Hypotheses, in another layout if ``axes`` says so.
    truth : array_like (M, K, D)
        True poses, likewise.
    where : bool array_like (M, K) or (M,), optional
        The joints that count.
    axes : str, optional
        The layout of the hypotheses, such as ``MNKD``. Where None, shapes that several layouts fit are refused.
    unit : str, float or None
        Of both, as for :func:`posecal.data.units.quantity`. Where None, mm, and poses that look like metres are
        refused.

    Returns
    -------
    tuple
        The three as arrays.

    Raises
    ------
    PoseDataError
        Where a dtype or a shape is wrong, or layout or unit are open; shapes are named with the letters that they
        break. And where all joints of some true poses, fewer than half of them, lie in one point.
    """
    x, y = real_array(hypotheses, "hypotheses"), real_array(truth, "truth")
    if axes is not None:
        Layout(axes, HYPOTHESES)
        stored = StoredPoses("hypotheses", MemoryArray(x)), StoredPoses("truth", MemoryArray(y))
        layout, true_layout = choose_layouts(*stored, axes, "MKD" if y.ndim == 3 else None)
        m, true_m = layout.shape(x.shape)[1], true_layout.shape(y.shape)[0]
        if m and true_m:
            x = layout.read(stored[0].array, np.arange(m))
            y = true_layout.read(stored[1].array, np.arange(true_m))
    shapes = f"hypotheses {x.shape} and truth {y.shape}"
    expected = "expected (N, M, K, D) and (M, K, D)"
    if x.ndim == 3 and y.ndim == 4:
        raise PoseDataError(f"{shapes}: {expected}. The two look swapped.")
    if x.ndim == y.ndim == 3:
        raise PoseDataError(f"{shapes}: {expected}. Of one prediction of each pose pass hypotheses[None].")
    if x.ndim != 4 or y.ndim != 3:
        raise PoseDataError(f"{shapes}: {expected}.")
    differing = [f"{letter} is {a} and {b}" for letter, a, b in zip("MKD", x.shape[1:], y.shape, strict=True) if a != b]
    if differing:
        fitting = [] if axes else plausible_layouts(x.shape, y.shape)
        hint = f" The shapes fit {option('axes', fitting[0])}." if fitting else ""
        raise PoseDataError(f"{shapes}: {expected}, but {', '.join(differing)}.{hint}")
    if 0 in x.shape:
        empty = [letter for letter, size in zip("NMKD", x.shape, strict=True) if size == 0]
        raise PoseDataError(f"{shapes}: {', '.join(empty)} is 0; expected at least one of each.")
    is_declared = _DECLARED.get() is not None
    if axes is None and not is_declared:
        refuse_ambiguous(f"{shapes}: {expected}", x.shape, plausible_layouts(x.shape, y.shape))
        if x.shape[3] > 3:
            raise PoseDataError(
                f"{shapes}: D = {x.shape[3]}; expected at most 3 coordinates of a position, last. Leave out a "
                "confidence (hypotheses[..., :3]), or exchange the axes."
            )
    _, factor = quantity_of(unit)
    x, y = (in_millimetres(array, factor) if factor != 1 or array.dtype.kind != "f" else array for array in (x, y))
    if unit is None and not is_declared:
        refuse_tiny(x, y)
    mask = None if where is None else checked_mask(where, y.shape[:2])
    if not is_declared and y[0].size > FEWEST_COORDINATES and is_one_point(y, mask).mean() < _MOST_POINTS:
        refuse_one_point(y, mask, np.arange(len(y)).astype(np.str_), "truth")
    return x, y, mask
