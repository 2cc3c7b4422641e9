"""Failures: whether the predicted spread tells poses of large errors from the others.

A pose fails where its error is above a threshold, by default 150 mm: the distance within which PCK and the Brier score
take a joint to be right, here of the mean over a pose's joints.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import partial

import numpy as np
import numpy.typing as npt

from posecal.calibration.ranks import shared_ranks
from posecal.data.arrays import BoolArray, FloatArray, checked_number
from posecal.engine.bounds import SHARE
from posecal.engine.metric import Metric, Need, Statistic
from posecal.engine.protocol import Protocol
from posecal.engine.scope import Scope
from posecal.engine.sums import Indices
from posecal.metrics.risk_coverage import known_pairs, run_numbers


def failure_auroc(spread: npt.ArrayLike, error: npt.ArrayLike, threshold: float = 150.0) -> float:
    """Area under the ROC curve (AUROC) of failures against successes, by the predicted spread.

    The probability that a failure, a pose of an error above the threshold, has a larger predicted spread than a
    success; equal spreads count half.

    Parameters
    ----------
    spread, error : arrays (M,)
        Of each pose, mm; poses with NaN are left out.
    threshold : float
        The error above which a pose fails, mm; for angles, pixels or no unit another than 150, in theirs.

    Returns
    -------
    float
        0 to 1; higher is better; 0.5 where the spread says nothing. NaN where no pose fails, or every pose does.

    Raises
    ------
    PoseDataError
        For shapes that don't fit, and a threshold that is no length.

    Notes
    -----
    Says nothing of how many poses fail. Differs from the published code: none.

    See Also
    --------
    aurc : Without a threshold.

    References
    ----------
    Hendrycks and Gimpel, arXiv:1610.02136; ties as in Hanley and McNeil, Radiology 143, 29 (1982).

    Examples
    --------
    One failure against two successes, of which one has a smaller spread and the other the same:

    >>> failure_auroc([3, 1, 3], [200, 100, 40])
    0.75
    """
    threshold = checked_number(threshold, "threshold", lambda mm: 0 < mm < np.inf, "a length above 0")
    s, e = known_pairs(spread, error)
    failed = e > threshold
    n = int(failed.sum())
    pairs = n * (len(e) - n)
    return float((shared_ranks(s)[failed].sum() - n * (n - 1) / 2) / pairs) if pairs else math.nan


def _ranks_within(values: FloatArray, group: npt.NDArray[np.generic]) -> FloatArray:
    """Rank of each value among those of its group, from 0; ties share the mean."""
    order = np.lexsort((values, group))
    run, own = run_numbers(group[order], values[order]), run_numbers(group[order])
    size = np.bincount(own)
    number = np.bincount(run)
    middle = np.cumsum(number) - (number + 1) / 2
    ranks = np.empty(len(values))
    ranks[order] = middle[run] - (np.cumsum(size) - size)[own]
    return ranks


def failure_auroc_without(
    spread: FloatArray, error: FloatArray, sequence: Indices, threshold: float = 150.0
) -> FloatArray:
    """ROC AUC of failures without the poses of each sequence in turn, (S,); exact, from two sorts of all poses."""
    S, failed = int(sequence.max(initial=-1)) + 1, error > threshold
    below = shared_ranks(spread) - _ranks_within(spread, failed)  # of the other class, for each pose
    lost = np.bincount(sequence, np.where(failed, below, failed.sum() - below), minlength=S)
    size = np.bincount(sequence, minlength=S)
    own = np.bincount(sequence, failed, minlength=S)
    both = (
        np.bincount(sequence, np.where(failed, _ranks_within(spread, sequence), 0), minlength=S) - own * (own - 1) / 2
    )
    n = failed.sum() - own
    pairs = n * (len(error) - size - n)
    return np.where(pairs > 0, (below[failed].sum() - lost + both) / np.maximum(pairs, 1), np.nan)


def _share_without(failed: BoolArray, sequence: Indices) -> FloatArray:
    """Share of failures without the poses of each sequence in turn, (S,)."""
    rest = len(failed) - np.bincount(sequence)
    return np.where(rest > 0, (failed.sum() - np.bincount(sequence, failed)) / np.maximum(rest, 1), np.nan)


# --- metrics --------------------------------------------------------------------------------------------------


def failure_metrics(scope: Scope, of_poses: Statistic, about: str) -> Iterator[Metric]:
    """AUROC of failures, and their share.

    Parameters
    ----------
    scope : Scope
        The options.
    of_poses : Statistic
        Predicted spread and error of every pose, (B, 2).
    about : str
        What these are.
    """
    threshold = scope.protocol.failure_threshold
    needs: tuple[Need, ...] = ("lengths",) if threshold == Protocol().failure_threshold else ()
    make = partial(Metric, unit="", family="sharpness", bounds=SHARE, needs=needs, statistic=of_poses)
    yield make(
        name="failure_auroc",
        label="AUROC of failures",
        direction="higher",
        brief=f"whether failures, of errors above {threshold:g} mm, have larger spreads; 0.5: no relation",
        definition="area under the ROC curve: P(spread of a failure > spread of a success), ties half; failure: error "
        f"above {threshold:g} mm; {about}",
        finish=lambda values: failure_auroc(values[:, 0], values[:, 1], threshold),
        leave_out=lambda values, sequence: failure_auroc_without(values[:, 0], values[:, 1], sequence, threshold),
        range="0 to 1 (every failure has a larger spread than every success); 0.5: no relation",
        reading="Whether a wide spread predicts a failure. Missing where no pose fails, or every pose does: "
        "failure_rate says how many fail, and the fewer of either, the wider the interval.",
        source="Hendrycks and Gimpel, arXiv:1610.02136",
    )
    yield make(
        name="failure_rate",
        label="failure rate",
        direction="lower",
        brief=f"share of poses of an error above {threshold:g} mm",
        definition=f"share of poses of an error above {threshold:g} mm; {about}",
        finish=lambda values: (values[:, 1] > threshold).mean() if len(values) else np.nan,
        leave_out=lambda values, sequence: _share_without(values[:, 1] > threshold, sequence),
        range="0 to 1",
        reading="What failure_auroc is about: the share of poses that fail. Unlike PCK it is of whole poses.",
        source="posecal",
    )
