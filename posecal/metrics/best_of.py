"""minMPJPE against the number of hypotheses.

With more hypotheses the best is better, for any model. The expected best of n ≤ N of them has a closed form, so that
two models with different N can be compared at the same n, without sampling anew.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache, partial

import numpy as np
import numpy.typing as npt

from posecal.data.arguments import checked
from posecal.data.arrays import BoolArray, FloatArray, as_array, checked_choice
from posecal.engine.block import Block
from posecal.engine.finish import entry
from posecal.engine.metric import Curve, Metric, Statistic
from posecal.engine.per_pose import per_pose
from posecal.engine.scope import Scope
from posecal.errors import PoseDataError
from posecal.geometry.procrustes import ALIGNMENTS, Alignment
from posecal.metrics.mpjpe import BEST_ERROR, error_words
from posecal.metrics.position import sorted_errors

Counts = npt.NDArray[np.intp]

ROUND_SIZES = (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000)
"""The n at which minMPJPE is reported apart from N, so that models with different N can be compared."""


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
    r"""Probability that the i-th smallest of N is the smallest of a random subset of n.

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


def subset_errors(
    block: Block, sizes: npt.NDArray[np.intp], align: Alignment = "none", body: BoolArray | None = None
) -> FloatArray:
    """Expected error of the best of a random subset of the hypotheses, (B, T), mm, for T subset sizes."""
    return np.asarray(sorted_errors(block, align, body) @ _weights_once(block.n_hypotheses, tuple(sizes.tolist())).T)


@cache
def _weights_once(n_hypotheses: int, sizes: tuple[int, ...]) -> FloatArray:
    """:func:`subset_weights`, the same for all blocks."""
    return subset_weights(n_hypotheses, sizes)


def min_mpjpe_curve(
    hypotheses: npt.ArrayLike,
    truth: npt.ArrayLike,
    /,
    sizes: npt.ArrayLike,
    *,
    align: Alignment = "none",
    where: npt.ArrayLike | None = None,
    root: int | None = None,
    axes: str | None = None,
    unit: str | float | None = None,
) -> FloatArray:
    r"""Expected minMPJPE of each pose with n of the N hypotheses, exactly, without sampling anew.

    .. math:: \sum_{i=1}^{N} e_{(i)} \binom{N - i}{n - 1} \Big/ \binom{N}{n}

    over the N errors of a pose in ascending order: the mean over all subsets of n hypotheses.

    Parameters
    ----------
    hypotheses, truth, align, where, root, axes, unit
        As for :func:`posecal.metrics.mpjpe`.
    sizes : array of int (T,)
        The n, each from 1 to N. At 1 it is the mean error, at N it is minMPJPE.

    Returns
    -------
    array (M, T)
        Errors, mm; lower is better; each row falls.

    Raises
    ------
    PoseDataError
        For shapes, dtypes, values, names or sizes that don't fit.

    Notes
    -----
    Differs from the published code: none; papers rerun with fewer samples.

    See Also
    --------
    posecal.metrics.min_mpjpe : With all N hypotheses.

    Examples
    --------
    Errors of 1, 2 and 6 mm: the best of two is 1 in two of three pairs and 2 in the third.

    >>> import numpy as np
    >>> hypotheses = np.array([1.0, 2.0, 6.0]).reshape(3, 1, 1, 1)
    >>> min_mpjpe_curve(hypotheses, np.zeros((1, 1, 1)), [1, 2, 3]).round(4)
    array([[3.    , 1.3333, 1.    ]])
    """
    checked_choice(align, "align", ALIGNMENTS)
    n = len(checked(hypotheses, truth, axes=axes, unit=unit)[0])
    asked = as_array(sizes, "sizes")
    if asked.ndim != 1 or asked.dtype.kind not in "iu" or not ((asked >= 1) & (asked <= n)).all():
        raise PoseDataError(f"sizes: {asked.tolist()}; expected whole numbers from 1 to N = {n}.")

    def statistic(block: Block) -> FloatArray:
        return subset_errors(block, asked, align)

    return per_pose(statistic, hypotheses, truth, where, root=root, axes=axes, unit=unit)


# --- metrics --------------------------------------------------------------------------------------------------


def _errors_by_n(scope: Scope) -> Statistic:
    sizes = curve_sizes(scope.spec.n_hypotheses)
    return Statistic("errors_by_n", partial(subset_errors, sizes=sizes, body=scope.body))


def subset_metrics(scope: Scope) -> Iterator[Metric]:
    """Expected minMPJPE at round numbers of hypotheses."""
    statistic, N = _errors_by_n(scope), scope.spec.n_hypotheses
    for index, n in enumerate(curve_sizes(N)):
        if n in ROUND_SIZES:
            yield BEST_ERROR(
                name=f"min_mpjpe_at_{n}",
                label=f"minMPJPE at n = {n}",
                brief=f"expected best of {n}",
                definition=f"mean over poses and over all subsets of {n} of the N={N} hypotheses of the smallest "
                f"error; error: {error_words(scope)}",
                statistic=statistic,
                finish=entry(index),
                needs=("alike hypotheses",),
            )


def subset_curve(scope: Scope) -> Curve:
    """Expected minMPJPE against the number of hypotheses."""
    N = scope.spec.n_hypotheses
    return Curve(
        name="errors_by_n",
        at=curve_sizes(N).astype(np.float64),
        axes=("hypotheses n", "minMPJPE [mm]"),
        definition=f"mean over poses and over all subsets of n of the N={N} hypotheses of the smallest error; error: "
        f"{error_words(scope)}",
        statistic=_errors_by_n(scope),
        needs=("alike hypotheses",),
    )
