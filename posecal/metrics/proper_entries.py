"""Which proper scores can be reported, and what says how far the spread is a guide to the error? Registry entries."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from posecal.data.arrays import FloatArray
from posecal.engine.block import Block
from posecal.engine.metric import Metric, Scope, Statistic, entry
from posecal.metrics.position import pose_errors
from posecal.metrics.proper import brier_counts, fair_brier, joint_crps, joint_energies, variograms
from posecal.metrics.sharpness import mean_over_joints, predicted_spread
from posecal.metrics.uncertainty import rank_correlation, sparsification_area

__all__ = ["PAIRED", "guide_metrics", "reliability_of_counts", "score_metrics", "skill_metrics"]


def guide_metrics(scope: Scope) -> Iterator[Metric]:
    """How the predicted spread of poses goes with their error."""

    def spread_and_error(block: Block) -> FloatArray:
        error = pose_errors(block, "none", "mean_pose", scope.body)[:, 0]
        return np.stack([predicted_spread(block, scope.moving), error], axis=1, dtype=np.float64)

    statistic = Statistic("spread_and_error", spread_and_error, per_pose=True)
    about = f"predicted spread (mean standard deviation of {scope.counted(scope.moving)}) and error of the mean pose"
    yield Metric(
        name="spread_error_correlation",
        label="spread against error",
        unit="",
        direction="higher",
        family="sharpness",
        brief="rank correlation over poses: is a wide spread a sign of error?",
        definition=f"Spearman's rank correlation over poses of {about}",
        statistic=statistic,
        finish=lambda kept: rank_correlation(kept[:, 0], kept[:, 1]),
        headline=True,
    )
    yield Metric(
        name="sparsification_area",
        label="sparsification area",
        unit="",
        direction="lower",
        family="sharpness",
        brief="of the error left when the most uncertain poses are dropped",
        definition="mean over dropped shares 0 … 0.95 of the error left when poses are dropped by spread, minus by "
        f"error, over the mean error; {about}",
        statistic=statistic,
        finish=lambda kept: sparsification_area(kept[:, 0], kept[:, 1]),
    )


def score_metrics(scope: Scope) -> Iterator[Metric]:
    """Energy score, CRPS, variogram score and Brier score."""
    joints, n = scope.counted(scope.moving), scope.spec.n_hypotheses

    statistic = Statistic("energies", lambda block: joint_energies(block, scope.moving), per_joint=True)
    yield Metric(
        name="energy_score",
        label="energy score",
        unit="mm",
        direction="lower",
        family="scores",
        brief=f"fair, whole pose of {scope.number(scope.moving)}",
        definition=f"mean over poses of mean ‖x − y‖ − ½ mean ‖x − x′‖, norm over {joints}; fair in N={n}",
        statistic=statistic,
        finish=entry(-1),
        by_joint=(statistic, lambda mean: mean[:-1]),
    )
    yield Metric(
        name="joint_energy_score",
        label="energy score of joints",
        unit="mm",
        direction="lower",
        family="scores",
        brief="fair, mean over joints of each joint's own",
        definition=f"mean over poses of mean ‖x − y‖ − ½ mean ‖x − x′‖ of one joint, mean over {joints}; fair in N={n}",
        statistic=statistic,
        finish=lambda mean: float(mean_over_joints(mean[:-1])),
    )
    crps = Statistic("crps", lambda block: joint_crps(block, scope.moving), per_joint=True)
    yield Metric(
        name="crps",
        label="CRPS",
        unit="mm",
        direction="lower",
        family="scores",
        brief="fair, mean over coordinates",
        definition=f"mean over poses of mean |x − y| − ½ mean |x − x′| of one coordinate, mean over axes and {joints}; "
        f"fair in N={n}",
        statistic=crps,
        finish=lambda mean: float(mean_over_joints(mean)),
        by_joint=(crps, np.asarray),
    )
    yield Metric(
        name="variogram_score",
        label="variogram score",
        unit="mm",
        direction="lower",
        family="scores",
        brief="fair, of √distance between joints",
        definition=f"mean over poses and pairs of {joints} of (√d(y) − mean √d(x))² − var √d(x) / N, d: distance of "
        f"the pair, N={n}",
        statistic=Statistic("variogram", lambda block: variograms(block, scope.moving)),
        finish=entry(),
    )
    threshold = scope.protocol.pck_threshold
    event = (
        f"of the truth, and the share of hypotheses of which, each of {joints} lies within {threshold:g} mm of the "
        f"median of the N={n} hypotheses"
    )
    yield Metric(
        name="brier",
        label=f"Brier score, {threshold:g} mm",
        unit="",
        direction="none",
        family="scores",
        brief=f"of: own median right to {threshold:g} mm at every joint; no ranking, the event is the model's own",
        definition=f"mean over poses of (p − o)² − p (1 − p) / (N − 1); o, p: {event}",
        statistic=Statistic("brier", lambda block: fair_brier(block, scope.moving, threshold)),
        finish=entry(),
    )
    counts = Statistic("brier_counts", lambda block: brier_counts(block, scope.moving, threshold))
    for name, place, words in (
        ("brier_miscalibration", 0, "part of the Brier score that recalibrated probabilities would remove"),
        ("brier_discrimination", 1, "part of the Brier score that telling poses apart removes"),
    ):
        yield Metric(
            name=name,
            label=name.replace("_", ", ").replace("brier", "Brier"),
            unit="",
            direction="none",
            family="scores",
            brief=words.removeprefix("part of the Brier score that "),
            definition=f"{words}, by isotonic regression of o on p, equal p pooled (CORP); o, p: {event}",
            statistic=counts,
            finish=lambda mean, place=place: reliability_of_counts(mean).parts[place],  # type: ignore[misc]
        )


def skill_metrics(scope: Scope) -> Iterator[Metric]:
    """How much better each proper score is than a reference's: 1 - S / S_ref, where there is a reference."""
    reference = scope.spec.reference
    if not reference:
        return
    for metric in score_metrics(scope):
        if metric.statistic.name not in _SKILLED:
            continue
        of_reference = f"the same of {reference}, fair in its N={scope.spec.n_reference}"
        if metric.name == "brier":
            of_reference += ", whose hypotheses too are held against the model's own median"

        def skill(mean: FloatArray, metric: Metric = metric) -> float:
            ours, theirs = metric.finish(mean[..., 0]), metric.finish(mean[..., 1])
            return 1 - ours / theirs if theirs > NOTHING else float("nan")

        yield Metric(
            name=metric.name.removesuffix("_score") + "_skill",
            label=f"skill, {metric.label.replace(' score', '')}",
            unit="",
            direction="higher" if metric.direction == "lower" else metric.direction,
            family="scores",
            brief=f"against {reference}: 0 no better, 1 perfect",
            definition=f"1 − S / S_ref, S: {metric.definition}; S_ref: {of_reference}",
            statistic=_both(metric.statistic, scope),
            finish=skill,
        )


_SKILLED = ("energies", "crps", "variogram", "brier")

NOTHING = 1e-9
"""A reference's score up to this, mm, is 0 but for rounding; there is no skill to have."""

PAIRED = "paired_"
"""How the names of statistics begin that hold a model's score and its reference's."""


def _both(statistic: Statistic, scope: Scope) -> Statistic:
    """Put a score of the reference beside the model's, in the last axis."""

    def both(block: Block) -> FloatArray:
        reference = block.reference
        assert reference is not None
        if statistic.name == "brier":
            theirs = fair_brier(block, scope.moving, scope.protocol.pck_threshold, forecast=reference)
        else:
            theirs = statistic.compute(reference)
        ours = block.share(("statistic", statistic.name), lambda: statistic.compute(block))
        return np.stack([ours, theirs], axis=-1)

    return Statistic(f"{PAIRED}{statistic.name}", both, statistic.per_joint)


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


def reliability_of_counts(counts: FloatArray) -> Reliability:
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
