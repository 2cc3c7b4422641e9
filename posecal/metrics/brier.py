"""Brier score of the event that the median pose is right at every joint, and its reliability.

The hypotheses give the event a probability: the share of them with every joint within the threshold of the median of
the others. (To the median of all, of which each is a part, they are nearer than a truth of the same law.)
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
from posecal.engine.finish import entry
from posecal.engine.metric import Metric, Need, Statistic
from posecal.engine.protocol import Protocol
from posecal.engine.scope import Scope
from posecal.metrics.proper import fair_per_pose

LEAST = 3
"""Hypotheses that it needs: of two, each is the other's median, and both are near or neither is."""


def _from_median_of_others(block: Block) -> FloatArray:
    """Give the distance of each hypothesis from the median of the others in each coordinate, (B, K, D, N).

    Without a value below the middle the median moves to ``above``, without one above it to ``below``: the farther of
    the two. Of an odd number the middle value itself leaves both of its neighbours.
    """
    x, (middle, odd) = block.offsets, divmod(block.n_hypotheses, 2)
    below, above = block.sorted[..., middle - 1, None], block.sorted[..., middle, None]
    if not odd:
        return np.maximum(above - x, x - below)
    at, last = above, block.sorted[..., middle + 1, None]
    distances = np.maximum((at + last) / 2 - x, x - (below + at) / 2)
    np.copyto(distances, abs(at - (below + last) / 2), where=x == at)
    return distances


def _within(
    block: Block, joints: BoolArray | None, threshold: float, forecast: Block | None = None
) -> tuple[FloatArray, BoolArray, BoolArray]:
    """Probability of every joint near the block's median, whether the truth is, and which poses count.

    A forecast's hypotheses are compared with that median, the block's own each with the median of the others.
    """
    scored = block.where if joints is None else block.where & joints
    centre = block.median[..., None]
    from_centre = _from_median_of_others(block) if forecast is None else forecast.offsets - centre
    reach = np.where(scored[..., None], squared_norms(block.shortest(from_centre)), 0).max(axis=1)
    truth = np.where(scored, squared_norms(block.shortest(centre))[..., 0], 0).max(axis=1)
    share: FloatArray = (reach < threshold**2).mean(axis=-1)
    return share, np.asarray(truth < threshold**2), np.asarray(scored.any(axis=1))


def _of_own(block: Block, joints: BoolArray | None, threshold: float) -> tuple[FloatArray, BoolArray, BoolArray]:
    """Give the same for the block's own hypotheses, once for the score and its parts."""
    key = ("own median", None if joints is None else joints.tobytes(), threshold)
    return block.share(key, lambda: _within(block, joints, threshold))


def fair_brier(
    block: Block, joints: BoolArray | None = None, threshold: float = 150.0, *, forecast: Block | None = None
) -> FloatArray:
    """Fair Brier score of "every joint lies within the threshold of the median pose", (B,); NaN for no joint.

    The probability is that of the forecast's hypotheses, by default the block's own; the median is the block's.
    """
    n = (block if forecast is None else forecast).n_hypotheses
    if n < (LEAST if forecast is None else 2):
        return np.full(len(block.where), np.nan)
    within = _of_own if forecast is None else partial(_within, forecast=forecast)
    share, happened, counted = within(block, joints, threshold)
    return np.where(counted, (share - happened) ** 2 - share * (1 - share) / (n - 1), np.nan)


def brier_counts(block: Block, joints: BoolArray | None = None, threshold: float = 150.0) -> FloatArray:
    """One-hot table of the predicted share and the outcome, (B, N + 1, 2); its sums give the reliability diagram."""
    n = block.n_hypotheses
    share, happened, counted = _of_own(block, joints, threshold)
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
    the share of the hypotheses of which every joint lies within it of the median of the others: the probability that
    the model gives the event.

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
        For fewer than three hypotheses, and shapes, dtypes or values that don't fit.

    Notes
    -----
    Whether a model knows when its own median can be relied on. The event is each model's own, so models are not ranked
    by it: one that is always wrong and knows it has a score of 0. From five hypotheses it is within about 0.01 of what
    fresh hypotheses would score for the same event. The event depends on N, as the median of few hypotheses is another
    pose than that of many: compare at equal N. Differs from the published code: none; the pose papers don't report it.

    See Also
    --------
    posecal.metrics.energy_score : A score by which models can be ranked.
    posecal.metrics.rank_correlation : Whether a wide spread is a sign of error.

    References
    ----------
    Brier, Mon. Weather Rev. 78, 1 (1950); Ferro (2014), doi:10.1002/qj.2270.

    Examples
    --------
    All three hypotheses lie near the median of the others, and the truth does not.

    >>> import numpy as np
    >>> hypotheses = np.array([200.0, 201.0, 202.0]).reshape(3, 1, 1, 1)
    >>> brier_score(hypotheses, np.zeros((1, 1, 1)))
    array([1.])
    """
    threshold = checked_number(threshold, "threshold", lambda mm: 0 < mm < np.inf, "a length above 0")
    if threshold == Protocol().pck_threshold:
        refuse_all_but_lengths(unit, f"threshold: {threshold:g} mm")
    score = partial(fair_brier, threshold=threshold)
    return fair_per_pose(score, hypotheses, truth, where, root, axes, unit, least=LEAST)


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
        f"o: whether each of {joints} of the truth lies within {threshold:g} mm of the median of the N={n} hypotheses; "
        "p: share of hypotheses of which each lies within it of the median of the others"
    )
    counted = partial(brier_counts, joints=scope.moving, threshold=threshold)
    needs: tuple[Need, ...] = ("three hypotheses", "alike hypotheses")
    make = partial(_BRIER, needs=("lengths", *needs) if threshold == Protocol().pck_threshold else needs)
    yield make(
        name="brier",
        label=f"Brier score at {threshold:g} mm",
        brief=f"of: own median right to {threshold:g} mm at every joint; no ranking, the event is the model's own",
        definition=f"mean over poses of (p − o)² − p (1 − p) / (N − 1); {event}",
        statistic=Statistic("brier", partial(fair_brier, joints=scope.moving, threshold=threshold)),
        finish=entry(),
    )
    for index, (name, words, most) in enumerate(
        (
            ("miscalibration", "that recalibrated probabilities would remove", 1.0),
            ("discrimination", "that telling poses apart removes", 0.25),  # at most o (1 − o)
        )
    ):
        yield make(
            name=f"brier_{name}",
            label=f"Brier {name}",
            range=f"0 to {most:g}",
            bounds=(0.0, most),
            brief=words.removeprefix("that "),
            definition=f"part of the Brier score {words}, by isotonic regression of o on p, equal p pooled (CORP); "
            f"{event}",
            statistic=Statistic("brier_counts", counted),
            finish=_part(index),
        )
