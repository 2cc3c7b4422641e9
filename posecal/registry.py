"""Which numbers are there, and which are asked for?"""

from __future__ import annotations

from posecal.calibration.table import calibration_metrics
from posecal.errors import did_you_mean, raise_all
from posecal.metric import Curve, Metric, Scope, Subject
from posecal.metrics.table import accuracy_curves, accuracy_metrics, spread_metrics
from posecal.protocol import Protocol

__all__ = ["curves_of", "known_metrics", "metrics_of"]


def known_metrics(protocol: Protocol, subject: Subject) -> dict[str, Metric]:
    """Every metric that a subject has what it takes for.

    Parameters
    ----------
    protocol : Protocol
        The options.
    subject : Subject
        What is measured.

    Returns
    -------
    dict
        Metrics by name, in the order of a report. With one hypothesis there is no calibration and no spread.

    Raises
    ------
    PoseDataError
        For options that don't fit the subject.
    """
    scope = Scope(protocol, subject)
    found = list(accuracy_metrics(scope))
    if subject.n_hypotheses > 1:
        found += [*calibration_metrics(scope), *spread_metrics(scope)]
    return {metric.name: metric for metric in found}


def metrics_of(protocol: Protocol, subject: Subject) -> dict[str, Metric]:
    """Choose the metrics that a protocol asks for.

    Parameters
    ----------
    protocol : Protocol
        The options; ``metrics`` names what is reported. The default are the headlines, and whatever comes free
        with them because it shares their statistics.
    subject : Subject
        What is measured.

    Returns
    -------
    dict
        Metrics by name, in the order of a report.

    Raises
    ------
    PoseDataError
        For an unknown name, or a metric that needs what the subject lacks; all such names at once.
    """
    known = known_metrics(protocol, subject)
    if protocol.metrics == "all":
        return known
    if protocol.metrics == "default":
        kept = {metric.statistic.name for metric in known.values() if metric.headline} | {
            "errors_by_n",
            "inside_reference",
        }
        return {name: metric for name, metric in known.items() if metric.statistic.name in kept}
    names = [word.strip() for word in protocol.metrics.split(",")]
    problems = [f"metrics: {name} {_lacks(name, subject, known)}" for name in names if name not in known]
    raise_all(problems)
    return {name: known[name] for name in known if name in names}


def _lacks(name: str, subject: Subject, known: dict[str, Metric]) -> str:
    if "mpjve" in name and "sequence" not in subject.labels:
        return "needs sequences. Store a label sequence in the truth's file."
    if ("weighted_pose" in name or "mode_mpjpe" in name) and not subject.scored:
        return "needs the model's scores. Store scores beside the hypotheses, or set mode to an index."
    if name.startswith(("ece", "signed", "coverage", "radius", "diversity")) and subject.n_hypotheses < 2:
        return "needs at least 2 hypotheses; there is 1."
    return f"is not known. {did_you_mean(name, known)}"


def curves_of(protocol: Protocol, subject: Subject) -> dict[str, Curve]:
    """Give the curves that pictures are drawn from.

    Parameters
    ----------
    protocol : Protocol
        The options.
    subject : Subject
        What is measured.

    Returns
    -------
    dict
        Curves by name.
    """
    return {curve.name: curve for curve in accuracy_curves(Scope(protocol, subject))}
