"""Brier score of the event that the median pose is right at every joint, and its reliability.

The hypotheses give the event a probability: the share of them with every joint within the threshold of their median.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial

import numpy as np
import numpy.typing as npt

from posecal.data.arguments import refuse_all_but_lengths
from posecal.data.arrays import BoolArray, FloatArray, checked_number, squared_norms
from posecal.engine.block import Block
from posecal.engine.bounds import SHARE
from posecal.engine.metric import Metric, Statistic, entry
from posecal.engine.protocol import Protocol
from posecal.engine.scope import Scope
from posecal.metrics.proper import fair_per_pose


def _within(
    block: Block, joints: BoolArray | None, threshold: float, forecast: Block
) -> tuple[FloatArray, BoolArray, BoolArray]:
    """Share of a forecast with every joint near the block's median, whether the truth is, and which poses count."""
    scored = block.where if joints is None else block.where & joints
    centre = block.median[..., None]
    reach = np.where(scored[..., None], squared_norms(block.shortest(forecast.offsets - centre)), 0).max(axis=1)
    truth = np.where(scored, squared_norms(block.shortest(centre))[..., 0], 0).max(axis=1)
    share: FloatArray = (reach < threshold**2).mean(axis=-1)
    return share, np.asarray(truth < threshold**2), np.asarray(scored.any(axis=1))


def fair_brier(
    block: Block, joints: BoolArray | None = None, threshold: float = 150.0, *, forecast: Block | None = None
) -> FloatArray:
    """Fair Brier score of "every joint lies within the threshold of the median pose", (B,); NaN for no joint.

    The probability is the share of the forecast's hypotheses, by default the block's own; the median is the block's.
    """
    forecast = block if forecast is None else forecast
    n = forecast.n_hypotheses
    share, happened, counted = _within(block, joints, threshold, forecast)
    if n < 2:
        return np.full(len(share), np.nan)
    return np.where(counted, (share - happened) ** 2 - share * (1 - share) / (n - 1), np.nan)


def brier_counts(block: Block, joints: BoolArray | None = None, threshold: float = 150.0) -> FloatArray:
    """One-hot table of the predicted share and the outcome, (B, N + 1, 2); its sums give the reliability diagram."""
    n = block.n_hypotheses
    share, happened, counted = _within(block, joints, threshold, block)
    table = np.zeros((len(share), n + 1, 2))
    table[np.arange(len(share)), np.rint(share * n).astype(int), happened.astype(int)] = 1
    table[~counted] = np.nan
    return table


def brier_score(
    hypotheses: npt.ArrayLike,
    truth: npt.ArrayLike,
    /,
    *,
    threshold: float = 150.0,
    where: npt.ArrayLike | None = None,
    root: int | None = None,
    axes: str | None = None,
    unit: str | float | None = None,
) -> FloatArray:
    r"""Fair Brier score of each pose for the event that the median pose is right at every joint.

    .. math:: (p - o)^2 - \frac{p (1 - p)}{N - 1}

    where o says whether every joint of the truth lies within the threshold of the median of the hypotheses, and p is
    the share of the hypotheses of which every joint does: the probability that the model gives the event.

    Parameters
    ----------
    hypotheses, truth, where, root, axes, unit
        As for :func:`posecal.metrics.energy_score`.
    threshold : float
        Distance below which a joint is right, mm; for angles, pixels or no unit another than 150, in theirs.

    Returns
    -------
    array (M,)
        Scores, about 0 to 1; lower is better; NaN for a pose without a joint that counts.

    Raises
    ------
    PoseDataError
        For fewer than two hypotheses, and shapes, dtypes or values that don't fit.

    Notes
    -----
    Whether a model knows when its own median can be relied on. The event is each model's own, so models are not ranked
    by it: one that is always wrong and knows it has a score of 0. Differs from the published code: none; the pose
    papers don't report it.

    See Also
    --------
    posecal.metrics.energy_score : A score by which models can be ranked.
    posecal.metrics.rank_correlation : Whether a wide spread is a sign of error.

    References
    ----------
    Brier, Mon. Weather Rev. 78, 1 (1950); Ferro (2014), doi:10.1002/qj.2270.

    Examples
    --------
    All three hypotheses lie near their median, and the truth does not.

    >>> import numpy as np
    >>> hypotheses = np.array([200.0, 201.0, 202.0]).reshape(3, 1, 1, 1)
    >>> brier_score(hypotheses, np.zeros((1, 1, 1)))
    array([1.])
    """
    threshold = checked_number(threshold, "threshold", lambda mm: 0 < mm < np.inf, "a length above 0")
    if threshold == Protocol().pck_threshold:
        refuse_all_but_lengths(unit, f"threshold: {threshold:g} mm")
    return fair_per_pose(lambda b: fair_brier(b, None, threshold), hypotheses, truth, where, root, axes, unit)


@dataclass(frozen=True)
class Reliability:
    """Isotonic reliability of predicted probabilities.

    Attributes
    ----------
    parts : tuple of float
        Miscalibration and discrimination: the mean squared error is the first, minus the second, plus o (1 - o) with o
        the share of poses at which the event happened.
    predicted, observed, weight : arrays (T,)
        The predicted probabilities that occur, the isotonic frequency of the event at each, and its share of poses.
    """

    parts: tuple[float, float]
    predicted: FloatArray
    observed: FloatArray
    weight: FloatArray


def reliability(counts: FloatArray) -> Reliability:
    """Regress the outcome on predicted probabilities, isotonically.

    Parameters
    ----------
    counts : array (N + 1, 2)
        Poses (or their shares of all poses) by the number of hypotheses for the event and by whether it happened.

    Returns
    -------
    Reliability
        NaN parts where there is no pose.

    References
    ----------
    Dimitriadis, Gneiting and Jordan, PNAS 118, e2016191118 (2021), doi:10.1073/pnas.2016191118.
    """
    total = counts.sum(axis=1)
    present = total > 0
    if np.isnan(counts).any() or not present.any():
        return Reliability((float("nan"), float("nan")), *[np.zeros(0)] * 3)
    from scipy.optimize import isotonic_regression

    predicted = np.flatnonzero(present) / (len(counts) - 1)
    weight = total[present] / total.sum()
    frequency = counts[present, 1] / total[present]
    observed = np.asarray(isotonic_regression(frequency, weights=weight).x)
    happened = float(counts[:, 1].sum() / total.sum())

    def squared(forecast: FloatArray) -> float:
        return float((weight * (frequency * (forecast - 1) ** 2 + (1 - frequency) * forecast**2)).sum())

    recalibrated = squared(observed)
    parts = squared(predicted) - recalibrated, happened * (1 - happened) - recalibrated
    return Reliability(parts, predicted, observed, weight)


# --- metrics --------------------------------------------------------------------------------------------------

_BRIER = partial(
    Metric,
    unit="",
    direction="none",
    family="scores",
    range="0 to about 1",
    bounds=SHARE,
    reading="Of the event that the median pose is right at every joint, to which the hypotheses give a probability. "
    "Its miscalibration part is what better probabilities alone would gain.",
    source="Brier (1950); Dimitriadis, Gneiting and Jordan, doi:10.1073/pnas.2016191118",
)


def _part(index: int) -> Callable[[FloatArray], FloatArray]:
    """Finish by one part of the Brier score, from counts (..., N + 1, 2) to (...)."""

    def finish(counts: FloatArray) -> FloatArray:
        parts = [reliability(table).parts[index] for table in counts.reshape(-1, *counts.shape[-2:])]
        return np.array(parts).reshape(counts.shape[:-2])

    return finish


def brier_metrics(scope: Scope) -> Iterator[Metric]:
    """The Brier score and its parts."""
    joints, n, threshold = scope.counted(scope.moving), scope.spec.n_hypotheses, scope.protocol.pck_threshold
    event = (
        f"of the truth, and the share of hypotheses of which, each of {joints} lies within {threshold:g} mm of the "
        f"median of the N={n} hypotheses"
    )
    counted = partial(brier_counts, joints=scope.moving, threshold=threshold)
    make = partial(_BRIER, needs=("lengths",) if threshold == Protocol().pck_threshold else ())
    yield make(
        name="brier",
        label=f"Brier score, {threshold:g} mm",
        brief=f"of: own median right to {threshold:g} mm at every joint; no ranking, the event is the model's own",
        definition=f"mean over poses of (p − o)² − p (1 − p) / (N − 1); o, p: {event}",
        statistic=Statistic("brier", partial(fair_brier, joints=scope.moving, threshold=threshold)),
        finish=entry(),
    )
    for index, (name, words) in enumerate(
        (
            ("miscalibration", "that recalibrated probabilities would remove"),
            ("discrimination", "that telling poses apart removes"),
        )
    ):
        yield make(
            name=f"brier_{name}",
            label=f"Brier, {name}",
            brief=words.removeprefix("that "),
            definition=f"part of the Brier score {words}, by isotonic regression of o on p, equal p pooled (CORP); "
            f"o, p: {event}",
            statistic=Statistic("brier_counts", counted),
            finish=_part(index),
        )
