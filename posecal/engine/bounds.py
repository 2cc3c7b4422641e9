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

_LARGEST_EXPONENT = 300.0


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


def ends_within(
    values: FloatArray, reach: FloatArray, number: FloatArray, bounds: Bounds
) -> tuple[FloatArray, FloatArray]:
    r"""Give the ends of intervals on the scale that belongs to a possible range.

    .. math:: g^{-1}\big(g(\hat\theta) \pm g'(\hat\theta)\, r\big), \qquad
              g(\theta) = \log\frac{\theta - a}{b - \theta}

    for a range from a to b: the logit of shares and Fisher's z of correlations; log(θ - a) where there is no b, and
    the plain interval where there is neither.

    Parameters
    ----------
    values, reach : arrays (K,)
        Numbers, and half-widths of their plain intervals.
    number : array (K,)
        Effective numbers of sequences.
    bounds : tuple of two float
        a and b, which may be infinite.

    Returns
    -------
    low, high : arrays (K,)
        The ends. Of a value at the edge of a finite range, where every sequence has it, the other end is that of the
        rule of three: :math:`b - (b - a)(1 - 0.05^{1/n})`. Of a value outside of the range, the plain interval.

    References
    ----------
    Hanley and Lippman-Hand, JAMA 249, 1743 (1983), doi:10.1001/jama.1983.03330370053031 (rule of three).

    Examples
    --------
    100 ± 69.3 mm are 50 to 200 mm on the log scale.

    >>> low, high = ends_within(np.array([100.0]), np.array([69.315]), np.array([5.0]), (0.0, math.inf))
    >>> low.round(1).item(), high.round(1).item()
    (50.0, 200.0)
    """
    lowest, highest = bounds
    if math.isinf(lowest) and not math.isinf(highest):
        low, high = ends_within(-values, reach, number, (-highest, math.inf))
        return -high, -low
    low, high = values - reach, values + reach
    if math.isinf(lowest):
        return low, high
    width = highest - lowest
    edge = 0.0 if math.isinf(width) else EDGE * width
    below, above = values - lowest, highest - values
    inner = (below > edge) & (above > edge)
    with np.errstate(divide="ignore", invalid="ignore"):
        exponent = np.minimum(reach * (1 / below + 1 / above), _LARGEST_EXPONENT)
        smaller, larger = (lowest + _moved(below, width, np.exp(e)) for e in (-exponent, exponent))
    low, high = np.where(inner, smaller, low), np.where(inner, larger, high)
    if math.isinf(width):
        return low, high
    known = ~np.isnan(reach)
    most = width * (1 - 0.05 ** (1 / np.maximum(number, 1)))
    at_low, at_high = (known & (np.abs(distance) <= edge) for distance in (below, above))
    low = np.where(at_low, lowest, np.where(at_high, highest - most, low))
    high = np.where(at_high, highest, np.where(at_low, lowest + most, high))
    return low, high


def _moved(below: FloatArray, width: float, factor: FloatArray) -> FloatArray:
    """Distance from the lower bound where the odds of that distance and the rest are multiplied by a factor."""
    return np.asarray(below * factor / (1 + below / width * (factor - 1)))
