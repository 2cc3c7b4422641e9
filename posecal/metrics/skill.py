"""Skill scores: how much better each proper score is than a reference's, 1 − S / S_ref."""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import partial

import numpy as np

from posecal.data.arrays import FloatArray
from posecal.engine.block import Block
from posecal.engine.metric import Metric, Statistic
from posecal.engine.scope import Scope
from posecal.metrics.brier import brier_metrics, fair_brier
from posecal.metrics.proper import score_metrics

NOTHING = 1e-9
"""A reference's score up to this, mm, is 0 but for rounding; no skill is defined relative to it."""

PAIRED = "paired_"
"""How the names of statistics begin that hold a model's score and its reference's."""


def skill_metrics(scope: Scope) -> Iterator[Metric]:
    """Skill of each proper score, where there is a reference."""
    reference = scope.spec.reference
    if not reference:
        return
    for metric in (*score_metrics(scope), *brier_metrics(scope)):
        if metric.name in {"brier_miscalibration", "brier_discrimination"}:
            continue
        of_reference = f"the same of {reference}, fair in its N={scope.spec.n_reference}"
        if metric.name == "brier":
            of_reference += ", whose hypotheses too are compared with the model's own median"
        yield Metric(
            name=metric.name.removesuffix("_score") + "_skill",
            label=f"skill of the {metric.label}",
            unit="",
            direction="higher" if metric.direction == "lower" else metric.direction,
            family="scores",
            needs=(*metric.needs, "climatology") if reference == "climatology" else metric.needs,
            brief=f"against {reference}: 0 no better, 1 perfect",
            definition=f"1 − S / S_ref, S: {metric.definition}; S_ref: {of_reference}",
            statistic=_paired(metric.statistic, scope),
            finish=partial(_skill, metric=metric),
            range="below 0 (worse than the reference) to 1 (perfect)",
            bounds=(-math.inf, 1.0),
            reading="The share of the reference's score that the model saves. Against climatology, a model that "
            "ignores the image has none, though it passes every calibration test.",
            source="Gneiting and Raftery, doi:10.1198/016214506000001437",
        )


def _skill(means: FloatArray, metric: Metric) -> FloatArray:
    """Compare a score with its reference's, from means (..., *shape, 2) to (...)."""
    score, reference = (np.asarray(metric.finish(means[..., index])) for index in (0, 1))
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(reference > NOTHING, 1 - score / reference, np.nan)


def _paired(statistic: Statistic, scope: Scope) -> Statistic:
    """Join a score of the reference to the model's, in the last axis."""

    def compute(block: Block) -> FloatArray:
        reference = block.reference
        assert reference is not None
        if statistic.name == "brier":
            threshold = scope.protocol.pck_threshold
            of_reference = fair_brier(block, scope.moving, threshold, forecast=reference)
        else:
            of_reference = statistic.compute(reference)
        own = block.share(("statistic", statistic.name), lambda: statistic.compute(block))
        return np.stack([own, of_reference], axis=-1)

    return Statistic(f"{PAIRED}{statistic.name}", compute, statistic.per_joint)
