"""Metrics split by occlusion: over the occluded and over the visible joints.

A pose has both, so these are no groups of poses. Per pose the mean over its occluded (or visible) joints is taken,
then the mean over poses; poses without such a joint drop out: the definition of the paper's occluded-joints column.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import numpy as np

from posecal.calibration.curve import is_resolved, joint_ece, signed_area
from posecal.calibration.error import unresolved
from posecal.calibration.ranks import LEVELS, coincide, inside
from posecal.calibration.standardized import standardized_errors_of
from posecal.data.arrays import BoolArray, FloatArray
from posecal.engine.block import Block
from posecal.engine.bounds import POSITIVE, SHARE
from posecal.engine.finish import entry
from posecal.engine.metric import Deviation, Metric, Statistic
from posecal.engine.needs import in_unit
from posecal.engine.protocol import Protocol
from posecal.engine.scope import DataSpec, Scope
from posecal.errors import PoseDataError
from posecal.metrics.position import joint_errors
from posecal.metrics.sharpness import joint_radii

OCCLUSION = ("occluded", "visible")
"""The two kinds of joints, in the order of the statistics' rows."""


def _masks(scope: Scope, block: Block) -> tuple[BoolArray, BoolArray]:
    scored = block.where & scope.moving
    return scored & block.occluded, scored & ~block.occluded


def _mean_over(mask: BoolArray, values: FloatArray) -> FloatArray:
    """Mean over the joints of a mask (B, K) of values (B, K, ...); NaN where there is none."""
    number = mask.sum(axis=1)
    shown = mask.reshape(*mask.shape, *[1] * (values.ndim - 2))
    total: FloatArray = np.where(shown, values, 0).sum(axis=1, dtype=np.float64)
    number = number.reshape(-1, *[1] * (total.ndim - 1))
    return np.where(number > 0, total / np.maximum(number, 1), np.nan)


def occlusion_metrics(scope: Scope, occlusion: str) -> Iterator[Metric]:
    """The numbers of one kind of joints, under the names that they have over all joints.

    Parameters
    ----------
    scope : Scope
        The joints.
    occlusion : str
        One of :data:`OCCLUSION`.
    """
    row, n = OCCLUSION.index(occlusion), scope.spec.n_hypotheses

    def inside_both(block: Block) -> FloatArray:
        weights, apart = inside(block), ~coincide(block)
        return np.stack([_mean_over(mask & apart & block.has_spread, weights) for mask in _masks(scope, block)], axis=1)

    def errors_both(block: Block) -> FloatArray:
        errors = joint_errors(block)
        means = [_mean_over(mask, errors) for mask in _masks(scope, block)]
        return np.stack([np.stack([mean.min(axis=-1), block.mean_of_each(mean)], axis=-1) for mean in means], axis=1)

    def radii_both(block: Block) -> FloatArray:
        radii = np.nan_to_num(joint_radii(block, (0.5,))[..., 0])
        return np.stack([_mean_over(mask & block.has_spread, radii) for mask in _masks(scope, block)], axis=1)

    curves = Statistic("occlusion_inside", inside_both, per_joint=True)
    errors = Statistic("occlusion_errors", errors_both, per_joint=True)
    radii = Statistic("occlusion_radii", radii_both, per_joint=True)
    of = f"mean over poses of the mean over their {occlusion} ones of {scope.size(scope.moving)}"
    inside_words = f"{of} of whether the truth is inside"
    metric = partial(Metric, brief=f"{occlusion} joints", in_group_table=True)
    error = partial(metric, unit="mm", direction="lower", family="accuracy", statistic=errors, bounds=POSITIVE)
    calibration = partial(metric, unit="", family="calibration", statistic=curves)
    yield error(
        name="min_mpjpe",
        label="minMPJPE",
        definition=f"{of} of ‖x − y‖, of the best of N={n} hypotheses for these joints of each pose",
        finish=entry(row, 0),
    )
    yield error(name="mpjpe", label="MPJPE", definition=f"{of} of ‖x − y‖, mean of N={n}", finish=entry(row, 1))
    yield calibration(
        name="ece",
        label="ECE",
        direction="lower",
        definition=f"mean over q of |ω(q) − q|; ω: {inside_words}, exchangeable, N={n}",
        finish=lambda means: joint_ece(means[..., row, :]),
        deviation=Deviation(row, row + 1, errors=standardized_errors_of(scope)),
    )
    yield calibration(
        name="signed_area",
        label="signed area",
        direction="zero",
        bounds=(-0.5, 0.5),
        definition=f"∫ (ω(q) − q) dq; ω: {inside_words}, exchangeable, N={n}",
        finish=lambda means: signed_area(means[..., row, :]),
    )
    in_balls = scope.spec.n_in_balls
    known = is_resolved(0.9, in_balls)
    yield calibration(
        name="coverage_90",
        label="coverage at 90 %",
        direction="none",
        bounds=SHARE,
        definition=f"{inside_words} the ball of 90 % of the hypotheses, exchangeable; best: 0.9"
        + ("" if known else unresolved(in_balls)),
        finish=entry(row, 90 * (LEVELS.size - 1) // 100) if known else lambda m: np.full(m.shape[:-2], np.nan),
    )
    yield metric(
        name="radius_50",
        label="radius of 50 %",
        unit="mm",
        direction="none",
        family="sharpness",
        bounds=POSITIVE,
        definition=f"{of} of the radius about the median that holds 50 % of the N={n} hypotheses",
        statistic=radii,
        finish=entry(row),
    )


def occlusion_metrics_of(protocol: Protocol, spec: DataSpec) -> dict[str, dict[str, Metric]]:
    """Give the numbers over occluded and over visible joints, by the kind of joint and by name.

    Those that were asked for by name; all of them where none was, or ``default`` or ``all``.

    Parameters
    ----------
    protocol : Protocol
        The options.
    spec : DataSpec
        What is measured.

    Returns
    -------
    dict
        Metrics by ``occluded`` and ``visible``, then by name.

    Raises
    ------
    PoseDataError
        Where the poses don't say which joints are occluded, or there is one hypothesis.
    """
    if not spec.has_occlusion:
        raise PoseDataError(
            "by: occlusion needs to know which joints are occluded; expected a member occluded or visible, bool (M, K)."
        )
    if spec.n_hypotheses < 2:
        raise PoseDataError("by: occlusion needs at least 2 hypotheses; there is 1.")
    scope = Scope(protocol, spec)
    metrics = {kind: [*occlusion_metrics(scope, kind)] for kind in OCCLUSION}
    known = {metric.name for metric in metrics[OCCLUSION[0]]}
    asked = known.intersection(protocol.wanted)
    if not asked or {"default", "all"}.intersection(protocol.wanted):
        asked = known
    return {kind: {m.name: in_unit(m, spec) for m in some if m.name in asked} for kind, some in metrics.items()}


def occlusion_words(protocol: Protocol, spec: DataSpec) -> str:
    """Say what the numbers by occlusion are of, where the others are of other joints, choices or metrics."""
    scope, metrics = Scope(protocol, spec), occlusion_metrics_of(protocol, spec)[OCCLUSION[0]].values()
    parts = [f"means over the occluded or visible ones of {scope.size(scope.moving)}"]
    if protocol.best != "frame" and any(metric.name == "min_mpjpe" for metric in metrics):
        parts.append(f"minMPJPE of the best hypothesis for these joints of each pose, not by best={protocol.best}")
    if not {"default", "all", *(metric.name for metric in metrics)}.intersection(protocol.wanted):
        parts.append("what was asked for is not among them")
    return f"numbers by occlusion: {'; '.join(parts)}."
