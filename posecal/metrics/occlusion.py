"""Is a model worse, or less sure, where it can't see? Numbers over the occluded and over the visible joints.

A pose has both, so these are no groups of poses. Per pose the mean over its occluded (or visible) joints is taken,
then the mean over poses; poses without such a joint drop out: the definition of the paper's occluded-joints column.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from posecal.calibration.error import joint_ece, signed_area
from posecal.calibration.ranks import LEVELS, inside
from posecal.data.arrays import BoolArray, FloatArray
from posecal.engine.block import Block
from posecal.engine.metric import Deviation, Metric, Scope, Statistic
from posecal.metrics.position import joint_errors
from posecal.metrics.sharpness import joint_radii

__all__ = ["OCCLUSION", "occlusion_metrics"]

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
    place, n = OCCLUSION.index(occlusion), scope.spec.n_hypotheses

    def inside_both(block: Block) -> FloatArray:
        weights = inside(block)
        return np.stack([_mean_over(mask, weights) for mask in _masks(scope, block)], axis=1)

    def errors_both(block: Block) -> FloatArray:
        errors = joint_errors(block)
        means = [_mean_over(mask, errors) for mask in _masks(scope, block)]
        return np.stack([np.stack([mean.min(axis=-1), mean.mean(axis=-1)], axis=-1) for mean in means], axis=1)

    def radii_both(block: Block) -> FloatArray:
        radii = np.nan_to_num(joint_radii(block, (0.5,))[..., 0])
        return np.stack([_mean_over(mask, radii) for mask in _masks(scope, block)], axis=1)

    curves = Statistic("occlusion_inside", inside_both, per_joint=True)
    errors = Statistic("occlusion_errors", errors_both, per_joint=True)
    radii = Statistic("occlusion_radii", radii_both, per_joint=True)
    of = f"mean over poses of the mean over their {occlusion} ones of {scope.size(scope.moving)}"
    for name, label, which, words in (
        ("min_mpjpe", "minMPJPE", 0, f"of ‖x − y‖, of the best of N={n} hypotheses for it"),
        ("mpjpe", "MPJPE", 1, f"of ‖x − y‖, mean of N={n}"),
    ):
        yield Metric(
            name=name,
            label=label,
            unit="mm",
            direction="lower",
            family="accuracy",
            brief=f"{occlusion} joints",
            definition=f"{of} {words}",
            statistic=errors,
            finish=lambda mean, which=which: float(mean[place, which]),  # type: ignore[misc]
        )
    yield Metric(
        name="ece",
        label="ECE",
        unit="",
        direction="lower",
        family="calibration",
        brief=f"{occlusion} joints",
        definition=f"mean over q of |ω(q) − q|; ω: {of} of whether the truth is inside, exchangeable, N={n}",
        statistic=curves,
        finish=lambda mean: float(joint_ece(mean[place])),
        deviation=Deviation(place, place + 1),
    )
    yield Metric(
        name="signed_area",
        label="signed area",
        unit="",
        direction="zero",
        family="calibration",
        brief=f"{occlusion} joints",
        definition=f"∫ (ω(q) − q) dq; ω: {of} of whether the truth is inside, exchangeable, N={n}",
        statistic=curves,
        finish=lambda mean: float(signed_area(mean[place])),
    )
    yield Metric(
        name="coverage_90",
        label="coverage at 90 %",
        unit="",
        direction="none",
        family="calibration",
        brief=f"{occlusion} joints",
        definition=f"{of} of whether the truth is inside the ball of 90 % of the hypotheses, exchangeable; best: 0.9",
        statistic=curves,
        finish=lambda mean: float(mean[place, 90 * (LEVELS.size - 1) // 100]),
    )
    yield Metric(
        name="radius_50",
        label="radius of 50 %",
        unit="mm",
        direction="none",
        family="sharpness",
        brief=f"{occlusion} joints",
        definition=f"{of} of the radius about the median that holds 50 % of the N={n} hypotheses",
        statistic=radii,
        finish=lambda mean: float(mean[place]),
    )
