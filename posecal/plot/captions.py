"""Captions of figures of reports: what is drawn, numbers with their definitions, and the signature."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING

from posecal.plot.curves import default_definition
from posecal.plot.skeletons import with_sign

if TYPE_CHECKING:
    from posecal.report.report import Report

_DASHED = {
    "pck": " Solid: joints; dashed: poses.",
    "sparsification": " Solid: by predicted spread; dashed: by the error itself.",
}
_DASHED["risk_coverage"] = _DASHED["sparsification"]
"""Of several models in one panel: what solid and dashed lines are."""


def caption(reports: Mapping[str, Report], kind: str, *, together: bool = False) -> str:
    """Write the caption of a figure.

    Parameters
    ----------
    reports : mapping of Report
        What is drawn, by the names of the models.
    kind : str
        A key of :data:`posecal.plot.KINDS`.
    together : bool
        Whether several models are in one panel.

    Returns
    -------
    str
        A paragraph, then the signature, of which there are several where they differ.
    """
    first = next(iter(reports.values()))
    numbers = {name: _numbers(report, kind) for name, report in reports.items()}
    words = [f"{name}: {found}." if len(reports) > 1 else f"{found}." for name, found in numbers.items() if found]
    words.append(_definition(first, kind, together=together) + _DASHED.get(kind, "") * together)
    signatures: dict[str, list[str]] = {}
    for name, report in reports.items():
        signatures.setdefault(report.signature, []).append(name)
    lines = [f"{', '.join(names)}: {text}" if len(signatures) > 1 else text for text, names in signatures.items()]
    return "\n".join([" ".join(words), *(f"signature: {line}" if len(lines) == 1 else line for line in lines)])


def _numbers(report: Report, kind: str) -> str:
    """Give the numbers that a figure of this kind is about; empty where there are none."""
    names = {
        "sparsification": ("ause",),
        "risk_coverage": ("aurc", "excess_aurc", "failure_auroc"),
        "event": ("brier",),
    }
    if kind != "reliability":
        words = []
        for name in names.get(kind, ()):
            if not math.isnan(value := report.value(name)):
                metric = report.metrics[name]
                words.append(f"{metric.label} {value:.3f} {metric.unit}".rstrip())
                words[-1] += f" (failure rate {report.value('failure_rate'):.4f})" * (name == "failure_auroc")
        return ", ".join(words)
    name = _error_of(report)
    words = [f"{report.metrics[name].label} {report.value(name):.4f}"] if name in report.metrics else []
    if name == "ece" and words and not math.isnan((null := report.test(name)).p):
        mean = "" if math.isnan(null.mean) else f"of a calibrated sampler {null.mean:.4f} on average, "
        words[-1] += f" ({mean}p {_written(null.p)})"
    if "signed_area" in report.metrics:
        words.append(f"signed area {with_sign(report.value('signed_area'), 4)}")
    return ", ".join(words)


def _written(p: float) -> str:
    return "< 0.001" if p < 0.001 else f"= {p:.3f}"


def _error_of(report: Report) -> str:
    definition = default_definition(report)
    return "ece" if definition == "exchangeable" else f"ece_{definition}"


def _definition(report: Report, kind: str, *, together: bool) -> str:
    if kind == "reliability":
        return _of_reliability(report, together=together)
    if kind == "joints":
        return (
            "∫ (ω_k(q) − q) dq of each joint k, exchangeable definition, "
            f"N={report.totals.spec.n_hypotheses}. A disc grows with the size of its joint's area."
        )
    if kind == "errors":
        return f"minMPJPE of n hypotheses: {report.curve('errors_by_n')[0].definition}."
    if kind == "sparsification":
        return f"AUSE: {report.definition('ause')}."
    if kind == "risk_coverage":
        return f"AURC: {report.definition('aurc')}."
    if kind == "event":
        return f"{report.metrics['brier'].label}: {report.definition('brier')}. Isotonic regression, equal p pooled."
    if kind == "rank_tests":
        return (
            "Exchangeable ranks of the truth by each pre-rank, minus uniform; grey: 95 % band by sequence sign-flips; "
            "p adjusted for the number of tests (Holm); orange: below 0.05."
        )
    if kind == "horizon":
        return (
            f"Mean over all poses at each horizon; bands: 95 % intervals over {report.totals.units()}; dashed: levels."
        )
    return f"Joints: {report.curve('pck_curve')[0].definition}. Poses: {report.curve('cps_curve')[0].definition}."


def _of_reliability(report: Report, *, together: bool) -> str:
    name = _error_of(report)
    words = f"{default_definition(report).capitalize()} definition."
    if name in report.metrics:
        words = f"{report.metrics[name].label}: {report.metrics[name].definition}."
    words += f"{'' if together else ' Grey: each joint;'} {'D' if together else 'd'}ashed: a calibrated sampler."
    if name != "ece" or name not in report.metrics or math.isnan((null := report.test(name)).band):
        return words
    band = f"{words} Band: 95 % of calibrated samplers, by sign-flips of {report.totals.units(null.sequences)}"
    return f"{band}{', the widest of the models' if together else ''}."
