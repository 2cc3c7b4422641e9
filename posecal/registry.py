"""Which numbers are there, and which are asked for?"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import replace

from posecal.calibration.entries import calibration_metrics, rank_test_metrics
from posecal.calibration.rank_tests import PreRank
from posecal.data.skeleton import JOINT_SETS
from posecal.engine.metric import Curve, DataSpec, Metric, Scope
from posecal.engine.protocol import Protocol
from posecal.errors import PoseDataError, did_you_mean, raise_all
from posecal.metrics.best_of import ROUND_SIZES
from posecal.metrics.occlusion import OCCLUSION, occlusion_metrics
from posecal.metrics.position_entries import accuracy_curves, accuracy_metrics, spread_metrics
from posecal.metrics.proper_entries import guide_metrics, score_metrics, skill_metrics

__all__ = ["GROUPS", "check_names", "curves_of", "known_metrics", "metrics_of", "occlusion_metrics_of"]


GROUPS = ("default", "rank_tests", "scores", "all")
"""Words that stand for several metrics."""


def known_metrics(
    protocol: Protocol, spec: DataSpec, preranks: Mapping[str, PreRank] | None = None
) -> dict[str, Metric]:
    """Every metric that a spec has what it takes for.

    Parameters
    ----------
    protocol : Protocol
        The options.
    spec : DataSpec
        What is measured.
    preranks : mapping of callables, optional
        The user's own pre-ranks, where their functions are at hand.

    Returns
    -------
    dict
        Metrics by name, in the order of a report. With one hypothesis there is no calibration and no spread.

    Raises
    ------
    PoseDataError
        For options that don't fit the spec.
    """
    scope = Scope(protocol, spec)
    found = list(accuracy_metrics(scope))
    if spec.n_hypotheses > 1:
        found += [*calibration_metrics(scope), *rank_test_metrics(scope, preranks), *score_metrics(scope)]
        found += skill_metrics(scope)
        found += [*spread_metrics(scope), *guide_metrics(scope)]
    if protocol.average != "poses":
        found = [replace(metric, definition=f"{metric.definition}; {_averaged(metric, protocol)}") for metric in found]
    return {metric.name: metric for metric in found}


def _averaged(metric: Metric, protocol: Protocol) -> str:
    """Say what is averaged over groups: curves before an error is read off them, else the groups' numbers."""
    what = (
        "read off the mean of the curves"
        if metric.family in {"calibration", "rank_tests"}
        else "the mean of its values"
    )
    return f"{what} for each {protocol.average}"


def metrics_of(protocol: Protocol, spec: DataSpec, preranks: Mapping[str, PreRank] | None = None) -> dict[str, Metric]:
    """Choose the metrics that a protocol asks for.

    Parameters
    ----------
    protocol : Protocol
        The options; ``metrics`` names what is reported: names, and the words of :data:`GROUPS`. ``default`` are the
        headlines, and whatever comes free with them because it shares their statistics.
    spec, preranks
        As for :func:`known_metrics`.

    Returns
    -------
    dict
        Metrics by name, in the order of a report.

    Raises
    ------
    PoseDataError
        For an unknown name, or a metric that needs what the spec lacks; all such names at once.
    """
    known = known_metrics(protocol, spec, preranks)
    words = protocol.wanted
    families = {metric.family for metric in known.values()}
    possible = {*known, "default", "all", *families.intersection(GROUPS)}
    raise_all(f"metrics: {word} {_lacks(word, spec, known)}" for word in words if word not in possible)
    free = {metric.statistic.name for metric in known.values() if metric.headline} | {"errors_by_n", "inside_reference"}
    return {
        name: metric
        for name, metric in known.items()
        if name in words
        or "all" in words
        or metric.family in words
        or ("default" in words and metric.statistic.name in free)
    }


def check_names(protocol: Protocol, own: Collection[str] = ()) -> None:
    """Refuse names of metrics that no data could make known.

    Parameters
    ----------
    protocol : Protocol
        The options.
    own : collection of str
        Names of the user's own metrics.

    Raises
    ------
    PoseDataError
        For the names, all at once.
    """
    joints, n = JOINT_SETS["h36m-17"], ROUND_SIZES[-1] + 1
    anything = DataSpec(
        n, joints, root=0, labels=("sequence",), fps=1.0, has_scores=True, has_occlusion=True, reference="another"
    )
    known = [*known_metrics(Protocol(), anything), *GROUPS, *own]
    unknown = [word for word in protocol.wanted if word not in known]
    if unknown:
        raise PoseDataError(f"metrics: {', '.join(unknown)} not known. {did_you_mean(unknown[0], known)}")


def _lacks(name: str, spec: DataSpec, known: dict[str, Metric]) -> str:
    if "mpjve" in name and "sequence" not in spec.labels:
        return "needs sequences. Store a label sequence in the truth's file."
    if not spec.has_scores and ("weighted_pose" in name or "mode_mpjpe" in name):
        otherwise = ", or set mode to an index" if "mode_mpjpe" in name else ""
        return f"needs the model's scores. Store scores beside the hypotheses{otherwise}."
    if spec.n_hypotheses < 2 and name in {*GROUPS, *known_metrics(Protocol(), replace(spec, n_hypotheses=2))}:
        return "needs at least 2 hypotheses; there is 1."
    return f"is not known. {did_you_mean(name, known)}"


def curves_of(protocol: Protocol, spec: DataSpec) -> dict[str, Curve]:
    """Give the curves that pictures are drawn from.

    Parameters
    ----------
    protocol : Protocol
        The options.
    spec : DataSpec
        What is measured.

    Returns
    -------
    dict
        Curves by name.
    """
    return {curve.name: curve for curve in accuracy_curves(Scope(protocol, spec))}


def occlusion_metrics_of(protocol: Protocol, spec: DataSpec) -> dict[str, dict[str, Metric]]:
    """Give the numbers over occluded and over visible joints, by the kind of joint and by name.

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
    return {
        occlusion: {metric.name: metric for metric in occlusion_metrics(scope, occlusion)} for occlusion in OCCLUSION
    }
