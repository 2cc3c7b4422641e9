"""How does one come from N errors to one?

Mostly by the smallest of them, and then the number depends on N: with more hypotheses the best is better, for any
model. The expected best of n ≤ N of them has a closed form, so that two models with different N can be compared
at the same n, without sampling anew.
"""

from __future__ import annotations

from typing import Literal, get_args

import numpy as np
import numpy.typing as npt

from posecal.data.arrays import FloatArray

__all__ = ["OF_ERRORS", "ROUND_SIZES", "OfErrors", "best_of", "curve_sizes", "subset_weights"]

Counts = npt.NDArray[np.intp]
OfErrors = Literal["min", "mean", "median", "worst"]
OF_ERRORS: tuple[OfErrors, ...] = get_args(OfErrors)


ROUND_SIZES = (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000)
"""The n at which minMPJPE is reported apart from N, so that models with different N can be compared."""


def best_of(errors: FloatArray, of: OfErrors = "min") -> FloatArray:
    """Reduce the N errors of each pose to one.

    Parameters
    ----------
    errors : array (..., N)
        Errors, mm.
    of : str
        ``min``, ``mean``, ``median`` or ``worst``.

    Returns
    -------
    array (...)
        Errors, mm.
    """
    if of == "median":
        return np.asarray(np.median(errors, axis=-1))
    if of == "mean":
        return np.asarray(errors.mean(axis=-1))
    return np.asarray(errors.min(axis=-1) if of == "min" else errors.max(axis=-1))


def curve_sizes(n_hypotheses: int, most: int = 40) -> npt.NDArray[np.intp]:
    """Choose the n at which minMPJPE against n is reported.

    Parameters
    ----------
    n_hypotheses : int
        N.
    most : int
        About how many.

    Returns
    -------
    array
        Rising whole numbers from 1 to N at about equal ratios, :data:`ROUND_SIZES` among them.
    """
    spaced = np.round(np.geomspace(1, n_hypotheses, most)).astype(np.intp)
    return np.unique([*(n for n in ROUND_SIZES if n <= n_hypotheses), *spaced])


def subset_weights(n_hypotheses: int, sizes: npt.ArrayLike) -> FloatArray:
    r"""Give the chance that the i-th smallest of N is the smallest of a random subset of n.

    .. math:: p_{n i} = \binom{N - i}{n - 1} \Big/ \binom{N}{n}, \qquad i = 1 \dots N

    Parameters
    ----------
    n_hypotheses : int
        N.
    sizes : array of int (T,)
        The n, each from 1 to N.

    Returns
    -------
    array (T, N)
        Chances; each row sums to 1. Times sorted errors, they give the expected best of n.

    Notes
    -----
    Differs from the published code: none; papers rerun with fewer samples instead.

    Examples
    --------
    Of three errors, the best of two is the smallest with chance 2/3 and the middle one with 1/3.

    >>> subset_weights(3, [2]).round(4)
    array([[0.6667, 0.3333, 0.    ]])
    """
    factorial = np.concatenate([[0.0], np.cumsum(np.log(np.arange(1, n_hypotheses + 1)))])  # its logarithm

    def log_binomial(over: Counts, under: Counts) -> FloatArray:
        return np.asarray(factorial[over] - factorial[under] - factorial[over - under])

    n = np.asarray(sizes, dtype=np.intp)[:, None]
    larger = np.arange(n_hypotheses)[::-1]  # N - i: how many errors are larger than the i-th
    possible = larger >= n - 1
    chances = log_binomial(np.maximum(larger, n - 1), n - 1) - log_binomial(np.full_like(n, n_hypotheses), n)
    return np.where(possible, np.exp(chances), 0.0)
