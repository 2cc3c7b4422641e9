"""What metrics need of the data, and the unit in which they are given."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import replace

from posecal.data.units import PERIODS
from posecal.engine.metric import Curve, Metric, Need
from posecal.engine.scope import DataSpec, Scope
from posecal.errors import first_few

NEEDS: dict[Need, str] = {
    "lengths": "lengths (or thresholds in the data's own unit)",
    "three axes": "positions of three coordinates",
    "positions": "positions, not angles",
    "three hypotheses": "at least 3 hypotheses",
    "alike hypotheses": "hypotheses of equal weight",
    "whole poses": "where = all and joints = all, because a log density is of the whole pose",
    "observed poses": "the last observed pose of each clip (a member observed beside the truth; in batches, also "
    "prepared=posecal.prepare(poses), of all poses)",
    "coordinate range": "one coordinate range; each of the results that were merged has its own",
    "climatology": "one climatology; each of the results that were merged has its own",
    "true clips": "the true clips of one run; each of the results that were merged has its own",
}
"""What metrics need of the data, in words."""

OF_ALL_POSES: tuple[Need, ...] = ("coordinate range", "climatology", "true clips")
"""Those that are found from all poses that are evaluated together."""

_AS_MANY = "as many hypotheses of every pose"

_OF_ANGLES = "; angles: circular mean, distances the shorter way round, order from the point opposite the mean"
_OF_CHORDS = "; angles: distances are chords of a circle of a circumference of 360 deg"

_SHOWN = 5
"""How many metrics of one need a remark names."""


def unmet(metric: Metric | Curve, scope: Scope) -> tuple[str, ...]:
    """Say in words which needs of a metric the data don't meet."""
    spec, lack = scope.spec, scope.lack(metric.name) if isinstance(metric, Curve) or metric.function is None else ""
    met = {"lengths": spec.unit == "mm", "three axes": spec.n_coordinates == 3, "positions": spec.unit not in PERIODS}
    met |= {
        "three hypotheses": spec.n_hypotheses > 2,
        "alike hypotheses": True,  # of others more is said below
        "whole poses": scope.is_whole,
        "observed poses": spec.has_observed,
        **{part: part not in spec.apart for part in OF_ALL_POSES},
    }
    if (spec.is_ragged or spec.has_weights) and not _takes_weights(metric):
        return (_AS_MANY if spec.is_ragged else NEEDS["alike hypotheses"],)
    if spec.has_weights and isinstance(metric, Metric) and metric.function is not None:
        return (NEEDS["alike hypotheses"],)
    return (*(NEEDS[need] for need in metric.needs if not met[need]), *([lack] if lack else []))


def _takes_weights(metric: Metric | Curve) -> bool:
    """Whether a metric is right for poses with different numbers of hypotheses, and for weighted ones.

    What follows one hypothesis from frame to frame is not, nor what has another expected value for each N; of others
    the metric says so itself.
    """
    if isinstance(metric, Metric) and (metric.sequences_per_batch or metric.offset is not None):
        return False
    return not (
        metric.statistic.earlier
        or metric.statistic.by_segment
        or metric.statistic.by_clip
        or "alike hypotheses" in metric.needs
    )


def in_unit(metric: Metric, spec: DataSpec) -> Metric:
    """Write a metric of posecal's for the data, in their unit; a user's own has the unit that the user gave it."""
    if spec.has_weights and "weights" not in metric.definition:
        metric = replace(metric, definition=f"{metric.definition}; hypotheses by their weights")
    if spec.unit == "mm" or metric.function is not None:
        return metric
    texts = {name: getattr(metric, name) for name in ("label", "brief", "definition", "range", "reading")}
    texts = {name: text.replace(" mm", f" {spec.unit}".rstrip()) for name, text in texts.items()}
    if spec.period is not None:
        texts["definition"] += _OF_CHORDS if "energy" in metric.name else _OF_ANGLES
    return replace(metric, **texts, unit=metric.unit.replace("mm", spec.unit or "1" * ("/" in metric.unit)))


def left_out(metrics: Iterable[Metric], scope: Scope, words: Collection[str]) -> str:
    """Say which metrics of a report the data can't have, and what they need.

    Parameters
    ----------
    metrics : iterable of Metric
        All metrics.
    scope : Scope
        What is measured, and the options.
    words : collection of str
        What was asked for: ``default``, ``all`` and families.

    Returns
    -------
    str
        One line; empty where nothing is left out.
    """
    groups: dict[str, list[str]] = {}
    for metric in metrics:
        shown = ("default" in words and metric.headline) or {"all", metric.family} & {*words}
        is_apart = {*metric.needs}.intersection(scope.spec.apart)  # of which a remark of its own says more
        for need in unmet(metric, scope)[:1] if shown and not is_apart else ():
            groups.setdefault(need, []).append(metric.name)
    parts = [f"{first_few(names, _SHOWN)}, which need {need}" for need, names in groups.items()]
    return f"left out: {'; '.join(parts)}." if parts else ""
