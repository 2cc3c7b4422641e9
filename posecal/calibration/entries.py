"""Which calibration numbers can be reported? The entries of the registry that are read off calibration curves."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import cast

import numpy as np

from posecal.calibration.curve import CalibrationCurve, inside_table
from posecal.calibration.error import OverJoints, ece, joint_ece, signed_area
from posecal.calibration.expected import expected_curve
from posecal.calibration.rank_tests import RANK_TESTS, PreRank, Test, user_weights
from posecal.calibration.ranks import DEFINITIONS, LEVELS, Definition
from posecal.data.arrays import FloatArray
from posecal.engine.block import Block
from posecal.engine.metric import Deviation, Metric, Scope, Statistic
from posecal.errors import PoseDataError

__all__ = ["calibration_metrics", "curve_of", "inside_statistic", "rank_test_metrics", "summary"]

_OVER = {
    "median": "the median over",
    "mean": "the mean over",
    "worst": "the worst of",
    "pooled": "per pose the mean over",
}


_DEVIATIONS: dict[str, Deviation] = {
    "median": Deviation(None, -1, "median"),
    "mean": Deviation(None, -1, "mean"),
    "worst": Deviation(None, -1, "worst"),
    "pooled": Deviation(-1),
}
"""How each summary of an ``inside`` statistic is made of its rows: K joints, and the pooled one."""


def inside_statistic(scope: Scope, definition: Definition) -> Statistic:
    """How far inside each q-ball the truth lies, (K + 1, Q); the last row pools the joints of a pose."""
    return Statistic(
        f"inside_{definition}", lambda block: inside_table(block, definition, scope.moving), per_joint=True
    )


def curve_of(mean: FloatArray, definition: Definition = "exchangeable") -> CalibrationCurve:
    """Read the mean of an ``inside`` statistic, (K + 1, Q), as calibration curves."""
    return CalibrationCurve(definition, mean[:-1], mean[-1])


def summary(mean: FloatArray, over: OverJoints) -> FloatArray:
    """The one curve, (Q,), that stands for all joints."""
    curve = curve_of(mean)
    if over == "pooled":
        return curve.pooled
    if over == "median":
        return curve.median
    counted = curve.coverage[~np.isnan(curve.coverage).any(axis=1)]
    if not len(counted):
        return np.full(LEVELS.size, np.nan)
    return np.asarray(counted.mean(axis=0) if over == "mean" else counted[joint_ece(counted).argmax()])


def calibration_metrics(scope: Scope) -> Iterator[Metric]:
    """ECE in its three definitions, and what the exchangeable curve says besides."""
    for definition in DEFINITIONS:
        yield from _errors(scope, definition)
    yield from _areas(scope)
    yield from _coverages(scope)


def _errors(scope: Scope, definition: Definition) -> Iterator[Metric]:
    statistic, joints = inside_statistic(scope, definition), scope.counted(scope.moving)
    over = cast(OverJoints, scope.protocol.summary_over_joints)
    suffix, label = ("", "ECE") if definition == "exchangeable" else (f"_{definition}", f"ECE ({definition})")
    briefs = {"median": "median of", "mean": "mean of", "worst": "worst of", "pooled": "pooled over"}
    about = f"{definition} definition, N={scope.spec.n_hypotheses}, {LEVELS.size} levels"
    offset = expected_curve(scope.spec.n_hypotheses, definition) - LEVELS
    summaries: tuple[tuple[str, str, OverJoints, str], ...] = (
        ("", "", over, f"mean over q of |ω(q) − q|, ω: {_OVER[over]} {joints}"),
        ("_mean", ", mean of joints", "mean", f"mean over {joints} of the mean over q of |ω_k(q) − q|"),
        ("_worst", ", worst joint", "worst", f"largest over {joints} of the mean over q of |ω_k(q) − q|"),
    )
    for ending, words, how, meaning in summaries:
        yield Metric(
            name=f"ece{suffix}{ending}",
            label=label + words,
            unit="",
            direction="lower",
            family="calibration",
            brief=f"{definition}; {briefs[how]} {scope.number(scope.moving)}",
            definition=f"{meaning}; {about}",
            statistic=statistic,
            finish=lambda mean, how=how: ece(curve_of(mean, definition), how),  # type: ignore[misc]
            by_joint=None if ending else (statistic, lambda mean: joint_ece(mean[:-1])),
            headline=definition != "reference" and not ending,
            deviation=_DEVIATIONS[how],
            offset=None if definition == "exchangeable" else offset,
        )


def _areas(scope: Scope) -> Iterator[Metric]:
    statistic, joints = inside_statistic(scope, "exchangeable"), scope.counted(scope.moving)
    over = cast(OverJoints, scope.protocol.summary_over_joints)

    def extreme(mean: FloatArray, sign: int) -> float:
        areas = signed_area(mean[:-1])
        areas = areas[~np.isnan(areas)]
        return float(sign * (sign * areas).max()) if areas.size else float("nan")

    yield Metric(
        name="signed_area",
        label="signed area",
        unit="",
        direction="zero",
        family="calibration",
        brief="− overconfident, + underconfident",
        definition=f"∫ (ω(q) − q) dq, exchangeable, ω: {_OVER[over]} {joints}; negative: overconfident, positive: "
        "underconfident",
        statistic=statistic,
        finish=lambda mean: float(signed_area(summary(mean, over))),
        by_joint=(statistic, lambda mean: signed_area(mean[:-1])),
        headline=True,
    )
    for name, words, sign in (("min", "smallest", -1), ("max", "largest", 1)):
        yield Metric(
            name=f"signed_area_{name}",
            label=f"signed area, {words} of joints",
            unit="",
            direction="zero",
            family="calibration",
            brief=f"{words} of {scope.number(scope.moving)}",
            definition=f"∫ (ω_k(q) − q) dq, exchangeable, the {words} over {joints}",
            statistic=statistic,
            finish=lambda mean, sign=sign: extreme(mean, sign),  # type: ignore[misc]
        )


def _coverages(scope: Scope) -> Iterator[Metric]:
    statistic, joints = inside_statistic(scope, "exchangeable"), scope.counted(scope.moving)
    over = cast(OverJoints, scope.protocol.summary_over_joints)
    for percent in (50, 80, 90, 95):
        place = percent * (LEVELS.size - 1) // 100
        yield Metric(
            name=f"coverage_{percent}",
            label=f"coverage at {percent} %",
            unit="",
            direction="none",
            family="calibration",
            brief=f"best: {percent / 100:g}",
            definition=f"share of truths inside the ball that holds {percent} % of the hypotheses, exchangeable, "
            f"{_OVER[over]} {joints}; best: {percent / 100:g}",
            statistic=statistic,
            finish=lambda mean, place=place: float(summary(mean, over)[place]),  # type: ignore[misc]
            by_joint=(statistic, lambda mean, place=place: mean[:-1, place]),  # type: ignore[misc]
            headline=True,
        )


def rank_test_metrics(scope: Scope, preranks: Mapping[str, PreRank] | None = None) -> Iterator[Metric]:
    """The battery: what the curve can't see, and the user's own pre-ranks.

    Parameters
    ----------
    scope : Scope
        The joints.
    preranks : mapping of callables, optional
        The functions of the user's pre-ranks, where they are at hand; a saved result has only their names.
    """
    for test in RANK_TESTS:
        yield _rank_metric(scope, test, lambda block, test=test: test.weights(block, scope.moving))  # type: ignore[misc]
    for name in scope.spec.preranks:
        own = (preranks or {}).get(name)
        test = Test(name, name, "the user's own", "the truth does not rank as one of the hypotheses would")

        def weights(block: Block, own: PreRank | None = own, name: str = name) -> FloatArray:
            if own is None:
                raise PoseDataError(f"prerank: {name!r} is not at hand; expected its function.")
            return user_weights(block, scope.moving, own)

        yield _rank_metric(scope, test, weights)


def _rank_metric(scope: Scope, test: Test, weights: Callable[[Block], FloatArray]) -> Metric:
    n, coordinates = scope.spec.n_hypotheses, test.name == "coordinate_pit"
    joints = scope.counted(scope.moving)
    over = f", mean over axes and {joints}" if coordinates else f" of poses of {joints}"
    statistic = Statistic(test.name, weights, per_joint=True)

    def by_joint(mean: FloatArray) -> FloatArray:
        return np.asarray(joint_ece(mean).mean(axis=-1))

    def finish(mean: FloatArray) -> float:
        errors = joint_ece(mean.reshape(-1, LEVELS.size))
        errors = errors[~np.isnan(errors)]
        return float(errors.mean()) if errors.size else float("nan")

    return Metric(
        name=test.name,
        label=test.label,
        unit="",
        direction="lower",
        family="rank_tests",
        brief=test.definition,
        definition=f"mean over q of |ω(q) − q|{over}, ω: exchangeable rank of the truth among N={n} hypotheses by the "
        f"{test.definition}",
        statistic=statistic,
        finish=finish,
        by_joint=(statistic, by_joint) if coordinates else None,
        deviation=Deviation(),
        rejection=test.rejection,
    )
