"""Explanations of metrics: definition, unit, range, direction, how to read them, and where they come from."""

from __future__ import annotations

import re
from functools import cache

from posecal.data.arrays import checked_choice
from posecal.data.skeleton import JOINT_SETS
from posecal.engine.metric import Family, Metric
from posecal.engine.protocol import CHOICES, Protocol
from posecal.engine.scope import DataSpec
from posecal.registry import any_metrics, registered_metrics
from posecal.report.table import AuxiliaryRow, auxiliary_rows

EVERYTHING = DataSpec(
    n_hypotheses=200,
    joints=JOINT_SETS["h36m-17"],
    root=0,
    labels=("sequence",),
    fps=50.0,
    has_scores=True,
    dimensions=48,
    reference="climatology",
    n_reference=200,
    clip_length=25,
    has_observed=True,
)
"""Data that every metric can be computed on."""

DIRECTIONS = {
    "lower": "lower is better",
    "higher": "higher is better",
    "zero": "0 is best",
    "none": "neither is better",
}

_TRIED = {name: choices for name, choices in CHOICES.items() if name not in {"root", "where"}} | {
    "best": ("sequence",),
    "mode": ("0",),
    "segment": ("sequence",),
    "pck_threshold": ("100",),
    "pck_joints": ("all",),
    "failure_threshold": ("100",),
    "mm_threshold": ("400",),
    "auc_range": ("0:50:100",),
    "cps_joints": ("all",),
}
"""Values of the options that change single metrics; the others change nearly all."""


def explain(name: str, protocol: Protocol | None = None, spec: DataSpec | None = None) -> str:
    """Explain a metric: what it is, and how to read it.

    Parameters
    ----------
    name : str
        A metric, the user's own that are registered among them, or a number that stands beside one, such as
        ``ece_null_95``.
    protocol : Protocol, optional
        The options that its definition is written out for.
    spec : DataSpec, optional
        What it is measured on; 200 hypotheses of 17 joints by default.

    Returns
    -------
    str
        Several lines.

    Raises
    ------
    PoseDataError
        For a name that is not known.

    Examples
    --------
    >>> print(explain("signed_area").splitlines()[0])
    signed_area: signed area
    """
    metrics = any_metrics(protocol or Protocol(), spec or EVERYTHING, own=registered_metrics())
    known: dict[str, Metric | AuxiliaryRow] = {**metrics, **auxiliary_rows(metrics)}
    number = known[checked_choice(name, "explain", known)]
    lines = {
        "definition": number.definition,
        "unit": number.unit or "none",
        "range": number.range,
        "direction": DIRECTIONS[number.direction],
        "how to read": number.reading,
        "rejection": number.rejection if isinstance(number, Metric) else "",
        "source": number.source,
    }
    return "\n".join([f"{name}: {number.label}", *(f"{key:11} {text}" for key, text in lines.items() if text)])


def metrics_table(family: Family) -> list[tuple[str, str, str, str, str]]:
    """Describe the metrics of a family, for the tables of the documentation.

    Parameters
    ----------
    family : str
        ``accuracy``, ``calibration``, ``rank_tests``, ``scores`` or ``sharpness``.

    Returns
    -------
    list of tuple of str
        Names, definition, unit, direction and the options that change it. Metrics whose names differ in a number, or in
        the prefix of an alignment, share a row with the definition of the first.
    """
    rows: dict[str, list[Metric]] = {}
    for metric in any_metrics(Protocol(), EVERYTHING).values():
        if metric.family == family:
            rows.setdefault(re.sub(r"^(pa|n)_|\d+", "", metric.name), []).append(metric)
    changing = _changing_options()
    return [
        (
            ", ".join(f"`{metric.name}`" for metric in metrics),
            metrics[0].definition,
            metrics[0].unit,
            DIRECTIONS[metrics[0].direction],
            ", ".join(f"`{option}`" for option in _TRIED if any(option in changing[m.name] for m in metrics)),
        )
        for metrics in rows.values()
    ]


@cache
def _changing_options() -> dict[str, set[str]]:
    """Find the options that change each metric: its definition, label or unit."""
    default = any_metrics(Protocol(), EVERYTHING)
    changing: dict[str, set[str]] = {name: set() for name in default}
    for option, values in _TRIED.items():
        for value in values:
            for name, metric in any_metrics(Protocol().changed({option: value}), EVERYTHING).items():
                before = default[name]
                if (metric.definition, metric.label, metric.unit) != (before.definition, before.label, before.unit):
                    changing[name].add(option)
    return changing
