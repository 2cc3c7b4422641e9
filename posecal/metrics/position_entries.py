"""Which accuracies and spreads can be reported? The entries of the registry for positions, PCK, CPS and spread."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import cast

import numpy as np

from posecal.data.arrays import BoolArray, FloatArray
from posecal.engine.block import Block
from posecal.engine.metric import Curve, Metric, Scope, Statistic, entry
from posecal.errors import PoseDataError
from posecal.geometry.procrustes import Alignment
from posecal.metrics.best_of import ROUND_SIZES, curve_sizes
from posecal.metrics.pck import (
    CPS_MOST,
    Selection,
    auc_share,
    correct_joints,
    correct_share,
    cps_area,
    joint_score,
    pose_score,
)
from posecal.metrics.position import OfPoses, joint_errors, linked, pose_errors, subset_errors
from posecal.metrics.sharpness import joint_deviations, joint_radii
from posecal.metrics.velocity import velocity_errors

__all__ = ["accuracy_curves", "accuracy_metrics", "spread_metrics"]

THRESHOLDS: FloatArray = np.arange(0, 301, 10.0)
"""Thresholds of the PCK and CPS curves, mm."""

_ALIGNED = {
    "none": "",
    "similarity": " after Procrustes alignment (scale, rotation, translation)",
    "rigid": " after rigid alignment (rotation, translation)",
    "reflection": " after Procrustes alignment with reflections allowed",
    "scale": " after least-squares scaling about the root",
    "norm_root": " after scaling to the true norm about the root",
    "rms_mean": " after centring and scaling to the true root mean square",
}
_SELECTED = {"own": "best hypothesis", "linked": "minMPJPE's hypothesis", "mean": "mean over hypotheses"}


def accuracy_metrics(scope: Scope) -> Iterator[Metric]:
    """Every accuracy that the spec has what it takes for."""
    for align, prefix in (("none", ""), (scope.protocol.align, "pa_"), (scope.protocol.scale, "n_")):
        yield from _of_errors(scope, cast(Alignment, align), prefix)
        yield from _of_one_pose(scope, cast(Alignment, align), prefix)
    yield from _of_subsets(scope)
    yield from _correct(scope)
    if "sequence" in scope.spec.labels:
        yield from _velocities(scope)


def _error_words(scope: Scope, align: Alignment) -> str:
    return f"mean over {scope.counted(scope.body)} of ‖x − y‖{_aligned_words(scope, align, scope.body)}"


def _aligned_words(scope: Scope, align: Alignment, scored: BoolArray) -> str:
    fitted_to_scored = scope.protocol.where == "all" and np.array_equal(scored, scope.fit)
    return _ALIGNED[align] + ("" if align == "none" or fitted_to_scored else f", fitted to {scope.size(scope.fit)}")


def _of_errors(scope: Scope, align: Alignment, prefix: str) -> Iterator[Metric]:
    n, body, fit, error = scope.spec.n_hypotheses, scope.body, scope.fit, _error_words(scope, align)
    by_link = prefix == "pa_" and scope.protocol.align_best == "linked"

    def of_n(block: Block) -> FloatArray:
        errors = pose_errors(block, align, body=body, fit=fit)
        least = linked(block, errors, body) if by_link else errors.min(axis=-1)
        return np.stack(
            [least, errors.mean(axis=-1), np.median(errors, axis=-1), errors.max(axis=-1)],
            axis=1,
            dtype=np.float64,
        )

    def of_joints(block: Block) -> FloatArray:
        errors = joint_errors(block, align, fit=fit)
        best = np.take_along_axis(
            errors, pose_errors(block, align, body=body, fit=fit).argmin(axis=-1)[:, None, None], axis=-1
        )
        found = np.stack([best[..., 0], errors.mean(axis=-1)], axis=-1, dtype=np.float64)
        return np.where((block.where & body)[..., None], found, np.nan)

    statistic, joints = Statistic(f"{prefix}errors", of_n), Statistic(f"{prefix}joint_errors", of_joints, True)
    words = (
        f"error of minMPJPE's of the N={n} hypotheses" if by_link else f"smallest of the N={n} errors",
        f"mean of the N={n} errors",
        f"median of the N={n} errors",
        f"largest of the N={n} errors",
    )
    briefs = (
        f"best of N={n} after aligning minMPJPE's" if by_link else f"best of N={n} per frame",
        f"mean of N={n}",
        f"median of N={n}",
        f"worst of N={n}",
    )
    labels = ("{}minMPJPE", "{}MPJPE", "{}MPJPE, median of N", "{}MPJPE, worst of N")
    for place, name in enumerate(("min_mpjpe", "mpjpe", "median_mpjpe", "worst_mpjpe")):
        metric = Metric(
            name=prefix + name,
            label=labels[place].format(_prefix_label(prefix)),
            unit="mm",
            direction="lower",
            family="accuracy",
            brief=f"{briefs[place]}, {scope.number(body)}",
            definition=f"mean over poses of the {words[place]}; error: {error}",
            statistic=statistic,
            finish=entry(place),
            by_joint=(joints, lambda mean, place=place: mean[:, place]) if place < 2 and not prefix else None,  # type: ignore[misc]
            headline=prefix + name in {"min_mpjpe", "mpjpe", "pa_min_mpjpe"},
        )
        yield metric if place else _best_over(scope, metric, align, prefix)


def _best_over(scope: Scope, metric: Metric, align: Alignment, prefix: str) -> Metric:
    """Change a minimum per pose into the minimum that the option ``best`` asks for."""
    kind, _, clips = scope.protocol.best.partition(":")
    n, error = scope.spec.n_hypotheses, _error_words(scope, align)
    if kind == "frame":
        return metric
    if kind == "joint":

        def per_joint(block: Block) -> FloatArray:
            weights = block.weights(scope.body)
            found = (weights * joint_errors(block, align, fit=scope.fit).min(axis=-1)).sum(axis=1, dtype=np.float64)
            return np.where(weights.any(axis=1), found, np.nan)

        def of_joints(block: Block) -> FloatArray:
            least = joint_errors(block, align, fit=scope.fit).min(axis=-1)
            return np.where(block.where & scope.body, least, np.nan)

        joints = Statistic(f"{prefix}joint_errors_of_best_joints", of_joints, True)
        return replace(
            metric,
            statistic=Statistic(f"{prefix}errors_of_best_joints", per_joint),
            finish=entry(),
            by_joint=None if metric.by_joint is None else (joints, np.asarray),
            brief=f"best of N={n} at each joint, {scope.number(scope.body)}",
            definition=f"mean over poses of the {error}, of the best of N={n} hypotheses at each joint",
        )
    if "sequence" not in scope.spec.labels:
        raise PoseDataError(f"best: {scope.protocol.best} needs sequences. Store a label sequence in the truth's file.")
    span = "sequence" if kind == "sequence" else f"batch of {clips} sequences"
    return replace(
        metric,
        statistic=Statistic(
            f"{prefix}errors_of_n", lambda block: pose_errors(block, align, body=scope.body, fit=scope.fit)
        ),
        finish=lambda mean: float(mean.min()),
        by_joint=None,
        sequences_per_batch=int(clips or 1),
        brief=f"best of N={n} per {span}, {scope.number(scope.body)}",
        definition=f"mean over poses, one of the N={n} hypotheses chosen per {span}; error: {error}",
    )


def _prefix_label(prefix: str) -> str:
    return {"": "", "pa_": "PA-", "n_": "N-"}[prefix]


def _of_one_pose(scope: Scope, align: Alignment, prefix: str) -> Iterator[Metric]:
    mode, n = scope.protocol.mode, scope.spec.n_hypotheses
    if mode != "score" and int(mode) >= n:
        raise PoseDataError(f"mode: {mode}; expected score or the index of one of {n} hypotheses.")
    words: dict[OfPoses, str] = {
        "mean_pose": "mean of the hypotheses",
        "median_pose": "per-coordinate median of the hypotheses",
    }
    if scope.spec.has_scores:
        words["weighted_pose"] = "mean of the hypotheses weighted by their scores"
    if mode != "score" or scope.spec.has_scores:
        words["mode"] = "hypothesis of the highest score" if mode == "score" else f"hypothesis of index {mode}"
    index = None if mode == "score" else int(mode)
    for of, pose in words.items():
        yield Metric(
            name=f"{prefix}{of}_mpjpe",
            label=f"{_prefix_label(prefix)}MPJPE, {of.replace('_', ' ')}",
            unit="mm",
            direction="lower",
            family="accuracy",
            brief=f"of the {pose}",
            definition=f"mean over poses of the error of the {pose}; error: {_error_words(scope, align)}",
            statistic=Statistic(
                f"{prefix}{of}_error",
                lambda block, of=of: pose_errors(block, align, of, scope.body, index, scope.fit)[:, 0],  # type: ignore[misc]
            ),
            finish=entry(),
            headline=prefix == "" and of == "mean_pose",
        )


def _subset_statistic(scope: Scope) -> Statistic:
    sizes = curve_sizes(scope.spec.n_hypotheses)
    return Statistic("errors_by_n", lambda block: subset_errors(block, sizes, body=scope.body))


def _of_subsets(scope: Scope) -> Iterator[Metric]:
    statistic, n_all = _subset_statistic(scope), scope.spec.n_hypotheses
    for place, n in enumerate(curve_sizes(n_all)):
        if n in ROUND_SIZES:
            yield Metric(
                name=f"min_mpjpe_at_{n}",
                label=f"minMPJPE at n = {n}",
                unit="mm",
                direction="lower",
                family="accuracy",
                brief=f"expected best of {n}",
                definition=f"mean over poses and over all subsets of {n} of the N={n_all} hypotheses of the smallest "
                f"error; error: {_error_words(scope, 'none')}",
                statistic=statistic,
                finish=entry(place),
            )


def _correct(scope: Scope) -> Iterator[Metric]:
    p = scope.protocol
    strict, best, joints = p.pck_rule == "<", cast(Selection, p.pck_best), scope.counted(scope.pck)
    yield Metric(
        name="pck",
        label=f"PCK {p.pck_threshold:g} mm",
        unit="",
        direction="higher",
        family="accuracy",
        brief=f"{scope.number(scope.pck)} {p.pck_rule} {p.pck_threshold:g} mm, {_SELECTED[best]}",
        definition=f"mean over poses of the share of {joints} with ‖x − y‖ {p.pck_rule} {p.pck_threshold:g} mm, "
        f"{_SELECTED[best]}",
        statistic=Statistic(
            "pck",
            lambda block: correct_joints(block, p.pck_threshold, best, scope.pck, scope.body, strict=strict),
        ),
        finish=entry(),
        headline=True,
    )
    exact = p.auc == "integral"
    grid = "its integral over 0 … 150 mm" if exact else "the thresholds 0, 5, … 150 mm"
    yield Metric(
        name="auc",
        label="AUC of PCK",
        unit="",
        direction="higher",
        family="accuracy",
        brief=f"mean of PCK over {grid}",
        definition=f"mean over {grid} of PCK ({p.pck_rule}) over {joints}, {_SELECTED[best]} at each threshold",
        statistic=Statistic(
            "auc",
            lambda block: joint_score(
                block, lambda e: auc_share(e, exact=exact, strict=strict), best, "none", scope.pck, scope.body
            ),
        ),
        finish=entry(),
        headline=True,
    )
    align, taken = cast(Alignment, p.cps_align), cast(Selection, p.cps_best)
    size = CPS_MOST if p.cps_unit == "share" else 1
    yield Metric(
        name="cps",
        label="CPS",
        unit="" if p.cps_unit == "share" else "mm",
        direction="higher",
        family="accuracy",
        brief=f"area to 300 mm of: all of {scope.counted(scope.cps)} within τ",
        definition=f"mean over poses of the area over τ = 1 … 300 mm of 1[each of {scope.counted(scope.cps)} within "
        f"τ]{_aligned_words(scope, align, scope.cps)}, {_SELECTED[taken]} at each τ"
        + ("; over 300 mm" if size > 1 else ""),
        statistic=Statistic(
            "cps", lambda block: pose_score(block, cps_area, taken, align, scope.cps, scope.body, scope.fit)
        ),
        finish=lambda mean: float(mean) / size,
        headline=True,
    )


def _velocities(scope: Scope) -> Iterator[Metric]:
    second, fps = scope.protocol.velocity == "second", scope.spec.fps
    if second and fps is None:
        raise PoseDataError("velocity: second needs the frames per second. Store fps in the truth's file.")
    factor = fps if second and fps is not None else 1.0
    kinds: tuple[tuple[str, OfPoses | None, str], ...] = (
        ("mpjve", None, "the mean over hypotheses, each followed through its sequence, of the"),
        ("mean_pose_mpjve", "mean_pose", "the mean of the hypotheses, the"),
    )
    for name, of, words in kinds:
        yield Metric(
            name=name,
            label="MPJVE" if of is None else "MPJVE, mean pose",
            unit="mm/s" if second else "mm/frame",
            direction="lower",
            family="accuracy",
            brief="of steps between frames",
            definition=f"mean over consecutive poses of a sequence of {words} mean over {scope.counted(scope.body)} of "
            "‖Δx − Δy‖",
            statistic=Statistic(
                name,
                lambda block, of=of: velocity_errors(block, of=of, body=scope.body).mean(axis=-1),  # type: ignore[misc]
            ),
            finish=lambda mean: float(mean) * factor,
        )


def accuracy_curves(scope: Scope) -> Iterator[Curve]:
    """MinMPJPE against n, and PCK and CPS against the threshold."""
    p, n = scope.protocol, scope.spec.n_hypotheses
    strict, best = p.pck_rule == "<", cast(Selection, p.pck_best)
    yield Curve(
        name="errors_by_n",
        at=curve_sizes(n).astype(np.float64),
        axes=("hypotheses n", "minMPJPE of n hypotheses [mm]"),
        definition=f"mean over poses and over all subsets of n of the N={n} hypotheses of the smallest error; error: "
        f"{_error_words(scope, 'none')}",
        statistic=_subset_statistic(scope),
    )

    def reached(errors: FloatArray) -> FloatArray:
        return correct_share(errors[..., None], THRESHOLDS, strict=strict)

    yield Curve(
        name="pck_curve",
        at=THRESHOLDS,
        axes=("threshold τ [mm]", "share of correct joints (PCK)"),
        definition=f"mean over poses of the share of {scope.counted(scope.pck)} with ‖x − y‖ {p.pck_rule} τ, "
        f"{_SELECTED[best]} at each τ",
        statistic=Statistic(
            "pck_curve", lambda block: joint_score(block, reached, best, "none", scope.pck, scope.body)
        ),
    )
    align, taken = cast(Alignment, p.cps_align), cast(Selection, p.cps_best)

    def complete(errors: FloatArray) -> FloatArray:
        return correct_share(errors[..., None], THRESHOLDS)

    yield Curve(
        name="cps_curve",
        at=THRESHOLDS,
        axes=("threshold τ [mm]", "share of correct poses"),
        definition=f"share of poses with each of {scope.counted(scope.cps)} within "
        f"τ{_aligned_words(scope, align, scope.cps)}, "
        f"{_SELECTED[taken]} at each τ",
        statistic=Statistic(
            "cps_curve", lambda block: pose_score(block, complete, taken, align, scope.cps, scope.body, scope.fit)
        ),
    )


def spread_metrics(scope: Scope) -> Iterator[Metric]:
    """Sharpness and diversity."""
    joints, n = scope.counted(scope.moving), scope.spec.n_hypotheses
    population = scope.protocol.deviation == "population"

    def radii(block: Block) -> FloatArray:
        return np.where(scope.moving[:, None], joint_radii(block, (0.5, 0.9)), np.nan)

    def deviations(block: Block) -> FloatArray:
        return np.where(scope.moving, joint_deviations(block, population=population), np.nan)

    statistic = Statistic("radii", radii, per_joint=True)
    for place, share in enumerate((50, 90)):
        yield Metric(
            name=f"radius_{share}",
            label=f"radius of {share} %",
            unit="mm",
            direction="none",
            family="sharpness",
            brief=f"mean radius about the median, {scope.number(scope.moving)}",
            definition=f"sharpness: radius about the per-coordinate median that holds {share} % of the N={n} "
            f"hypotheses, mean over poses, then over {joints}",
            statistic=statistic,
            finish=lambda mean, place=place: _mean(mean[:, place]),  # type: ignore[misc]
            by_joint=(statistic, lambda mean, place=place: mean[:, place]),  # type: ignore[misc]
            headline=True,
        )
    statistic = Statistic("deviations", deviations, per_joint=True)
    yield Metric(
        name="diversity",
        label="diversity",
        unit="mm",
        direction="none",
        family="sharpness",
        brief=f"standard deviation of the hypotheses ({'n' if population else 'n − 1'})",
        definition=f"standard deviation over the N={n} hypotheses ({'n' if population else 'n − 1'}), mean over axes "
        f"and poses, then over {joints}",
        statistic=statistic,
        finish=_mean,
        by_joint=(statistic, np.asarray),
        headline=True,
    )


def _mean(values: FloatArray) -> float:
    counted = values[~np.isnan(values)]
    return float(counted.mean()) if counted.size else float("nan")
