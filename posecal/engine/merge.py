"""Merging of the sums of shards of one test set, such as files, processes or machines."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from posecal.data.remarks import Count, Example, Remark, join_remarks
from posecal.engine.apart import without_apart, without_own_cuts
from posecal.engine.cells import RUNS, run_length
from posecal.engine.gallery import Gallery, join_galleries, of_part, of_parts
from posecal.engine.measure import of_plain_poses
from posecal.engine.pose_hashes import MOST_HASHES, shared_poses, smallest_hashes
from posecal.engine.totals import Totals
from posecal.errors import PoseDataError, first_few, option, raise_all

Cell = tuple[str, ...]

FAN_IN = 32
"""How many results are added at a time where there are many."""

_OVER_TIME = ("mpjve", "acceleration", "jitter", "wa_errors", "w_errors", "clip", "final_errors", "multimodal")
"""Words in the names of statistics that are of several consecutive poses."""


def merge_totals(parts: Sequence[Totals], names: Sequence[str] | None = None) -> Totals:
    """Add the results of shards of one test set.

    Parameters
    ----------
    parts : sequence of Totals
        At least one; evaluated alike.
    names : sequence of str, optional
        What messages call them.

    Returns
    -------
    Totals
        What one run over all poses gives. What depends on which poses are evaluated together is left out, with a
        remark, unless the shards found it from the same poses: ``tarp_box`` (where they were evaluated with one
        ``prepared``), skills against climatology, and groups by equal parts of the predicted spread. Runs of poses
        without sequence labels stay those of their shard, and no difference over time and no segment reaches over a
        cut. A sequence may be split over shards.

    Raises
    ------
    PoseDataError
        Where two differ in more than their poses, or hold the same poses, and for other than one name each.
    """
    if not hasattr(parts, "__len__") or not parts or not all(isinstance(part, Totals) for part in parts):
        raise PoseDataError("merge: expected results (Totals, such as report.totals), at least one.")
    names = [_ordinal(number) for number in range(1, len(parts) + 1)] if names is None else names
    if len(names) != len(parts):
        raise PoseDataError(f"names: {len(names)} for {len(parts)} results; expected one each.")
    runs = [part.prepared_hashes.get(RUNS) for part in parts]
    are_numbered = None not in runs and len({*runs}) == 1
    if len(parts) > 1 and not are_numbered and any(part.spec.has_clip_numbers for part in parts):
        raise PoseDataError(
            f"{names[0]} and {names[1]}: sequences are the numbers of clips, alike in each; expected labels "
            f"{option('clip')} or {option('sequence')}, so that clips of parts have different names."
        )
    parts, lost = without_apart(_with_weights(parts))
    labels = [name for name in parts[0].cells if all(name in part.cells for part in parts)]
    labels, uncut = without_own_cuts(parts, labels)
    _refuse_unlike(parts, names)
    _refuse_shared(parts, names)
    first, has_sequences = parts[0], all(part.has_sequences for part in parts)
    hashes = {name: value for name, value in first.prepared_hashes.items() if name != RUNS or are_numbered}
    sequences = [part.cells["sequence"].tolist() for part in parts]
    if not has_sequences and not are_numbered and len(parts) > 1:
        sequences = _joined_runs(sequences)
    rows: dict[Cell, int] = {}
    numbers = [
        np.array([rows.setdefault(cell, len(rows)) for cell in _cells(part, labels, names)], dtype=np.intp)
        for part, names in zip(parts, sequences, strict=True)
    ]
    n_frames = sum(part.n_frames for part in parts)
    values = np.array(list(rows), dtype=np.str_).reshape(len(rows), len(labels))
    total = Totals(
        spec=first.spec,
        protocol=first.protocol,
        version=first.version,
        cells={label: values[:, column] for column, label in enumerate(labels)},
        poses=np.zeros(len(rows), dtype=np.int64),
        remarks=join_remarks((remark for part in parts for remark in part.remarks), n_frames),
        n_frames=n_frames,
        has_sequences=has_sequences,
        pose_hashes=smallest_hashes([part.pose_hashes for part in parts]),
        own_metrics=first.own_metrics,
        prepared_hashes=hashes,
        gallery=_joined_gallery(parts, has_sequences),
    )
    cut = "" if first.spec.clip_length and are_numbered else _cut_sequences(parts)  # those of a set hold whole clips
    new = (remark for remark in (*lost, uncut, cut) if remark and remark not in total.remarks)
    total.remarks = (*total.remarks, *new)
    for part, cells in zip(parts, numbers, strict=True):
        np.add.at(total.poses, cells, part.poses)
        for statistic in first.sums:
            total.add(statistic, cells, part.sums[statistic], part.counts[statistic])
    total.per_pose = {name: np.concatenate([part.per_pose[name] for part in parts]) for name in first.per_pose}
    if total.per_pose:
        total.cell_of = np.concatenate([cells[part.cell_of] for part, cells in zip(parts, numbers, strict=True)])
    return total


def in_order_of_sequences(totals: Totals, sequences: Sequence[str]) -> Totals:
    """Put the cells in the order of some sequences; as they are where sequences are runs of poses."""
    if not totals.has_sequences:
        return totals
    place = {name: number for number, name in enumerate(sequences)}
    order = np.argsort([place[name] for name in totals.cells["sequence"].tolist()], kind="stable")
    number = np.argsort(order)
    return replace(
        totals,
        cells={name: values[order] for name, values in totals.cells.items()},
        poses=totals.poses[order],
        sums={name: sums[order] for name, sums in totals.sums.items()},
        counts={name: counts[order] for name, counts in totals.counts.items()},
        cell_of=number[totals.cell_of],
    )


def _joined_gallery(parts: Sequence[Totals], has_sequences: bool) -> Gallery | None:
    """Choose among the galleries of all parts; None where one has none, for its poses may be the worst."""
    galleries = [part.gallery for part in parts if part.gallery is not None]
    if len(galleries) < len(parts):
        return None
    if not has_sequences and len(parts) > 1:
        galleries = of_parts(galleries)
    return join_galleries(galleries)


def _cut_sequences(parts: Sequence[Totals]) -> str:
    """Remark on sequences that lie in several parts, where something is measured over time."""
    is_over_time = any(word in name for name in parts[0].sums for word in _OVER_TIME)
    if not is_over_time or not all(part.has_sequences for part in parts):
        return ""
    in_parts = Counter(name for part in parts for name in dict.fromkeys(part.cells["sequence"].tolist()))
    if cut := [name for name, number in in_parts.items() if number > 1]:
        return Remark(
            Count(len(cut), "sequence lies", "sequences lie"),
            " in several results (first: ",
            Example.of(cut),
            "): no difference over time and no segment reaches over a cut.",
        )
    return ""


def _with_weights(parts: Sequence[Totals]) -> Sequence[Totals]:
    """Keep what poses with absent or weighted hypotheses can have, where some of the shards hold such poses."""
    kinds = {(part.spec.is_ragged, part.spec.has_weights) for part in parts}
    if len(kinds) == 1:
        return parts
    return [_of_names(part, parts) for part in parts]


def _of_names(part: Totals, parts: Sequence[Totals]) -> Totals:
    """Keep the sums of names that all of several parts have, and how many hypotheses a pose has."""
    spec = part.spec
    for other in parts:
        spec = spec.together_with(other.spec)
    names = set.intersection(*({*other.sums} for other in parts))
    of_plain = of_plain_poses(spec.n_hypotheses)
    of_n = {name: part.sums.get(name, value * part.poses) for name, value in of_plain.items()}
    number = {name: part.counts.get(name, part.poses) for name in of_plain}
    kept = set.intersection(*({*other.per_pose} for other in parts))
    return replace(
        part,
        spec=spec,
        sums={key: sums for key, sums in part.sums.items() if key in names} | of_n,
        counts={key: counts for key, counts in part.counts.items() if key in names} | number,
        per_pose={key: values for key, values in part.per_pose.items() if key in kept},
    )


def _cells(part: Totals, labels: Sequence[str], sequences: Sequence[str]) -> list[Cell]:
    """Give the labels of each cell, with its sequence by this name."""
    columns = [sequences if label == "sequence" else part.cells[label].tolist() for label in labels]
    return list(zip(*columns, strict=True))


def _joined_runs(parts: Sequence[Sequence[str]]) -> list[list[str]]:
    """Name runs of poses after their shard; of too many of them, consecutive ones are one."""
    named = [[f"{number}/{run}" for run in runs] for number, runs in enumerate(parts, 1)]
    places = {run: place for place, run in enumerate(dict.fromkeys(run for runs in named for run in runs))}
    if (length := run_length(len(places))) == 1:
        return named
    return [[str(places[run] // length) for run in runs] for runs in named]


def merge_tree(parts: Iterable[Totals]) -> Totals:
    """Add the results of many shards as they come, some at a time: memory holds a few of them.

    Parameters
    ----------
    parts : iterable of Totals
        As for :func:`merge_totals`, at least one.

    Returns
    -------
    Totals
        What one merge of all gives.
    """
    levels: list[list[Totals]] = [[]]
    for number, part in enumerate(parts, 1):
        gallery = None if part.gallery is None or part.has_sequences else of_part(part.gallery, number)
        levels[0].append(part if gallery is None else replace(part, gallery=gallery))
        for level, waiting in enumerate(levels):
            if len(waiting) == FAN_IN:
                if level + 1 == len(levels):
                    levels.append([])
                levels[level + 1].append(merge_totals(waiting))
                waiting.clear()
    return merge_totals([part for waiting in reversed(levels) for part in waiting])


def _ordinal(number: int) -> str:
    """Name one of several results: ``the 1st result``."""
    ending = "th" if number % 100 in {11, 12, 13} else {1: "st", 2: "nd", 3: "rd"}.get(number % 10, "th")
    return f"the {number}{ending} result"


def _refuse_unlike(parts: Sequence[Totals], names: Sequence[str]) -> None:
    first, problems = parts[0], []
    for name, part in zip(names[1:], parts[1:], strict=True):
        if part.signature != first.signature:
            problems.append(f"{names[0]} and {name} were not made alike: {difference_of_signatures(first, part)}.")
        if metrics := different_metrics(first, part):
            problems.append(f"{names[0]} and {name} define {metrics} differently; expected the same metrics.")
        if first.protocol.velocity == "second" and part.spec.fps != first.spec.fps:
            rates = f"{first.spec.fps:g} and {part.spec.fps:g}"
            problems.append(f"{names[0]} and {name} have {rates} frames per second; expected the same.")
        if part.spec.clip_length != first.spec.clip_length:
            lengths = f"T = {first.spec.clip_length} and {part.spec.clip_length}"
            problems.append(f"{names[0]} and {name} have clips of {lengths} frames (0: none); expected the same.")
        statistics = ({*t.sums, *t.per_pose} for t in (first, part))
        differing = set.symmetric_difference(*statistics)
        if differing:
            problems.append(
                f"{names[0]} and {name} were asked for different metrics (sums in one only: "
                f"{first_few(sorted(differing))}); expected the same {option('metrics')} and {option('by')}."
            )
        shapes = [{name: array.shape[1:] for name, array in t.sums.items()} for t in (first, part)]
        other = [name for name in shapes[0] if shapes[0][name] != shapes[1].get(name, shapes[0][name])]
        if other and part.signature == first.signature:
            problems.append(
                f"{names[0]} and {name} have sums of different shapes ({first_few(other)}); expected those of one "
                "version. Evaluate the older one again."
            )
        if first.has_sequences != part.has_sequences:
            problems.append(f"{names[0]} and {name}: only one has sequence labels; expected both, or neither.")
    raise_all(problems)


def _refuse_shared(parts: Sequence[Totals], names: Sequence[str]) -> None:
    """Refuse poses that two shards have in common."""
    hashes = [part.pose_hashes for part in parts]
    first, second, number = shared_poses(hashes)
    if number:
        some = "at least " * any(len(of_part) == MOST_HASHES for of_part in hashes)
        raise PoseDataError(
            f"{names[first]} and {names[second]} hold the same poses: {some}{number:,} with the same truth and labels; "
            "expected every pose in one only. Leave them out of one, or give both a frame_id where they are different "
            "frames."
        )


def different_metrics(one: Totals, other: Totals) -> str:
    """Name the user's metrics that two results have by the same name and describe otherwise; nothing where none is."""
    described = {metric.name: metric.description for metric in one.own_metrics}
    return ", ".join(m.name for m in other.own_metrics if described.get(m.name, m.description) != m.description)


def difference_of_signatures(one: Totals, other: Totals) -> str:
    """Say in what two results were not made alike."""
    first, second = (dict(part.split("=", 1) for part in t.signature.split()) for t in (one, other))
    keys = [key for key in {**first, **second} if first.get(key) != second.get(key)]
    return ", ".join(f"{key} {first.get(key, 'default')} against {second.get(key, 'default')}" for key in keys)
