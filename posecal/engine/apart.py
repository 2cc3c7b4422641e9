"""What shards had found from their own poses alone, and what is left out of their sum for that."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

from posecal.engine.cells import SPREAD
from posecal.engine.needs import OF_ALL_POSES
from posecal.engine.totals import Totals
from posecal.errors import PoseDataError, option


class _Part(NamedTuple):
    """What is found from all poses that are evaluated together.

    Attributes
    ----------
    statistics : str
        How the names of statistics begin that depend on it.
    metrics : tuple of str
        How the names of metrics end that do.
    remark : str
        What to say of these.
    """

    statistics: str
    metrics: tuple[str, ...]
    remark: str


_PARTS: dict[str, _Part] = dict(
    zip(
        OF_ALL_POSES,
        (
            _Part(
                "tarp_box",
                ("tarp_box",),
                "tarp_box is left out: each of these results has it by the coordinate range of its own poses. Evaluate "
                "all poses in one run, or in Python each shard by Evaluation(prepared=…) with posecal.prepare of all "
                "true poses.",
            ),
            _Part(
                "paired_",
                ("_skill",),
                "skills are left out: each of these results has the climatology of its own poses. Evaluate all poses "
                "in one run, or all shards against the same hypotheses of another model.",
            ),
            _Part(
                "multimodal_",
                ("mmade", "mmfde", "apde"),
                "mmade, mmfde and apde are left out: each of these results has the true clips of its own poses as sets "
                "of truths. Evaluate all poses in one run, or in Python each shard by Evaluation(prepared=…) with "
                "posecal.prepare of all true poses.",
            ),
        ),
        strict=True,
    )
)


def without_apart(parts: Sequence[Totals]) -> tuple[Sequence[Totals], list[str]]:
    """Leave out the numbers for which shards that are merged had found something from their own poses.

    Parameters
    ----------
    parts : sequence of Totals
        The shards, at least one.

    Returns
    -------
    parts : sequence of Totals
        Without these numbers, and with what was found so in their ``spec.apart``.
    remarks : list of str
        Which numbers these are, and what to do.

    Raises
    ------
    PoseDataError
        Where no number would be left.
    """
    apart, remarks = [], []
    for name, part in _PARTS.items():
        holds = any(statistic.startswith(part.statistics) for totals in parts for statistic in totals.sums)
        if name == "climatology" and not any(totals.spec.reference == name for totals in parts):
            continue  # of another model it does not matter which poses are together
        found = [totals.prepared_hashes.get(name) for totals in parts]
        differ = len(parts) > 1 and holds and (None in found or len({*found}) > 1)
        if differ or any(name in totals.spec.apart for totals in parts):
            apart.append(name)
            remarks += [part.remark] if differ else []
    if not apart:
        return parts, []
    return [_without(totals, tuple(apart)) for totals in parts], remarks


def _without(totals: Totals, apart: tuple[str, ...]) -> Totals:
    lost = [_PARTS[name] for name in apart]
    own = {metric.name for metric in totals.own_metrics}
    words = [w for w in totals.protocol.wanted if w in own or not any(w.endswith(part.metrics) for part in lost)]
    if not words:
        raise PoseDataError(f"merge: no other metrics. {lost[0].remark}")
    kept = [name for name in totals.sums if not any(name.startswith(part.statistics) for part in lost)]
    return replace(
        totals,
        spec=replace(totals.spec, apart=apart),
        protocol=replace(totals.protocol, metrics=", ".join(words)),
        sums={name: totals.sums[name] for name in kept},
        counts={name: totals.counts[name] for name in kept},
        prepared_hashes={name: value for name, value in totals.prepared_hashes.items() if name not in apart},
    )


def without_own_cuts(parts: Sequence[Totals], labels: Sequence[str]) -> tuple[list[str], str]:
    """Leave out labels by which each shard cut the predicted spread of its own poses into equal parts.

    Parameters
    ----------
    parts : sequence of Totals
        The shards.
    labels : sequence of str
        Labels that all of them have.

    Returns
    -------
    labels : list of str
        The others.
    remark : str
        Which those are, and what to do; empty where there is none.
    """
    lost = []
    for label in labels:
        names = {value for part in parts for value in part.cells[label].tolist()}
        if SPREAD.match(label) and len(names) > len({name.partition(":")[0] for name in names}):
            lost.append(label)
    if not lost:
        return list(labels), ""
    cuts = option("by", "predicted_spread=40,60")
    remark = f"groups by {', '.join(lost)} are left out: each of these results cut its own poses. Give cuts, as {cuts}."
    return [label for label in labels if label not in lost], remark
