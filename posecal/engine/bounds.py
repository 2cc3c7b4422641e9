"""The possible range of a number, and intervals that stay within it: on the log, logit, Fisher's z or plain scale."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

from posecal.data.arrays import FloatArray
from posecal.errors import PoseDataError

Bounds = tuple[float, float]
"""Smallest and largest possible value of a number; infinite where there is none."""

UNBOUNDED: Bounds = (-math.inf, math.inf)
POSITIVE: Bounds = (0.0, math.inf)
SHARE: Bounds = (0.0, 1.0)
CORRELATION: Bounds = (-1.0, 1.0)

EDGE = 1e-9
"""A share this near to 0 or 1, or a correlation to −1 or 1, lies there but for rounding."""

_LARGEST = 700.0


def checked_bounds(bounds: object) -> Bounds:
    """Check the two bounds of a metric; None stands for none.

    Raises
    ------
    PoseDataError
        For anything but two numbers, the smaller first.
    """
    ends = tuple(bounds) if isinstance(bounds, Iterable) else ()
    if len(ends) == 2 and all(end is None or isinstance(end, int | float) for end in ends):
        low, high = (none if end is None else float(end) for end, none in zip(ends, UNBOUNDED, strict=True))
        if low < high:
            return low, high
    raise PoseDataError(f"metric: bounds {bounds!r}; expected the smallest and the largest possible value.")


def finite_bounds(bounds: Bounds) -> list[float | None]:
    """Write bounds as JSON has them: None for none."""
    return [end if math.isfinite(end) else None for end in bounds]


def to_scale(values: FloatArray, bounds: Bounds) -> FloatArray:
    r"""Map numbers to the scale that belongs to their possible range.

    .. math:: g(\theta) = \log\frac{\theta - a}{b - \theta}

    for a range from a to b: the logit of shares, twice Fisher's z of correlations; log(θ - a) where there is no b,
    -log(b - θ) where there is no a, and θ where there is neither.

    Parameters
    ----------
    values : array
        Numbers.
    bounds : tuple of two float
        a and b, which may be infinite.

    Returns
    -------
    array
        Infinite at the edge of the range and beyond it.

    References
    ----------
    Fisher, Metron 1, 3 (1921) (z of a correlation).

    Examples
    --------
    >>> to_scale(np.array([0.5, 1.0]), SHARE), to_scale(np.array([1.0, 0.0]), POSITIVE)
    (array([ 0., inf]), array([  0., -inf]))
    """
    low, high = bounds
    if bounds == UNBOUNDED:
        return values
    edge = EDGE * (high - low) if math.isfinite(high - low) else 0.0
    scaled = np.zeros(values.shape)
    with np.errstate(divide="ignore"):
        if math.isfinite(low):
            scaled += np.log(np.where(values - low <= edge, 0, values - low))
        if math.isfinite(high):
            scaled -= np.log(np.where(high - values <= edge, 0, high - values))
    return scaled


def from_scale(scaled: FloatArray, bounds: Bounds) -> FloatArray:
    """Map back what :func:`to_scale` gives."""
    low, high = bounds
    if bounds == UNBOUNDED:
        return scaled
    factor = np.exp(np.clip(scaled, -_LARGEST, _LARGEST))
    if math.isinf(high):
        return low + factor
    return np.asarray(high - 1 / factor if math.isinf(low) else high - (high - low) / (1 + factor))


def ends_at_edges(values: FloatArray, number: FloatArray, bounds: Bounds) -> tuple[FloatArray, FloatArray]:
    r"""Give the intervals of numbers at the edge of a finite range, where every sequence has it: the rule of three.

    .. math:: \big[\, b - (b - a)(1 - 0.05^{1/n}),\; b \,\big]

    Parameters
    ----------
    values : array (K,)
        Numbers.
    number : array (K,)
        Effective numbers of sequences, n.
    bounds : tuple of two float
        a and b.

    Returns
    -------
    low, high : arrays (K,)
        NaN of numbers elsewhere, and where one of the bounds is infinite.

    References
    ----------
    Hanley and Lippman-Hand, JAMA 249, 1743 (1983), doi:10.1001/jama.1983.03330370053031.
    """
    least, most = bounds
    if not math.isfinite(most - least):
        return np.full(values.shape, np.nan), np.full(values.shape, np.nan)
    width, edge = (most - least) * (1 - 0.05 ** (1 / number)), EDGE * (most - least)
    at_least, at_most = np.abs(values - least) <= edge, np.abs(values - most) <= edge
    low = np.where(at_least, least, np.where(at_most, most - width, np.nan))
    high = np.where(at_most, most, np.where(at_least, least + width, np.nan))
    return low, high
