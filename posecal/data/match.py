"""Matching of hypotheses with the truth: frames by id, joints by name, labels that must agree.

Everything that does not fit is raised together.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from posecal.data.arrays import BoolArray, FloatArray, checked_number
from posecal.data.clips import clip_length, describe_clips, short_clip_remarks, with_clip_labels, with_horizons
from posecal.data.declarations import Declarations, choose_layouts, joint_names, quantity_of, refuse_other_names
from posecal.data.degenerate import column_problem
from posecal.data.draws import DrawnHypotheses, stated_log_density, with_counts
from posecal.data.frame_numbers import order_by_number
from posecal.data.joint_names import match_joints, remarks_on_matched, remarks_on_names
from posecal.data.layout import TRUTH, Layout, plausible_layouts
from posecal.data.log_density import log_density
from posecal.data.members import both, frame_id_remarks, read_members, unread_remarks, with_frames_of_clips
from posecal.data.own_skeleton import parents_among
from posecal.data.remarks import Count, Example, Remark
from posecal.data.root import choose_root, origin, part_of_root, root_name
from posecal.data.skeleton import ALL_NAMES
from posecal.data.stored_poses import ArrayHypotheses, Labels, Rows, StoredPoses, in_millimetres
from posecal.data.units import OTHERS
from posecal.data.weights import checked_weights, poses_last
from posecal.errors import PosecalError, PoseDataError, attempt, first_few, option, raise_all

Names = tuple[str, ...]


class Matcher:
    """Hypotheses and truth that are being matched, with what does not fit and what is to be known.

    Parameters
    ----------
    hypotheses, truth : StoredPoses
        As stored or passed.
    declared : Declarations
        What the user declares about them.

    Attributes
    ----------
    layouts : tuple of two Layouts
        Of the hypotheses and of the truth.
    shape, true_shape : tuple of int
        (N, M, K, D) and (M, K, D).
    problems, remarks : list
        What does not fit, and what a careful reader should know.
    """

    def __init__(
        self,
        hypotheses: StoredPoses,
        truth: StoredPoses,
        declared: Declarations,
        problems: Iterable[str | PosecalError] = (),
    ) -> None:
        self.hypotheses, self.truth, self.declared = hypotheses, truth, declared
        self.problems, self.remarks = [*problems], list[str]()
        layouts = attempt(self.problems, choose_layouts, hypotheses, truth, declared.axes, declared.truth_axes)
        if layouts is None:
            self._look_at_truth_alone()
            raise_all(self.problems)
        assert layouts is not None
        self.layouts, self.clip_length = layouts, clip_length(layouts, hypotheses, truth)
        self.shape, self.true_shape = layouts[0].shape(hypotheses.array.shape), layouts[1].shape(truth.array.shape)
        self.hypotheses = with_frames_of_clips(hypotheses, self.shape[1], self.clip_length)
        self.truth = with_frames_of_clips(truth, self.true_shape[0], self.clip_length)
        if 0 in hypotheses.array.shape + truth.array.shape:
            raise_all(empty_problem(poses) for poses in (hypotheses, truth) if 0 in poses.array.shape)

    def _look_at_truth_alone(self) -> None:
        """Collect what is wrong beside a layout that is not known, as far as the truth's shape tells."""
        text = self.truth.axes or self.declared.truth_axes or TRUTH
        shape = attempt([], Layout(text, TRUTH).shape, self.truth.array.shape)
        if shape is not None:
            read_members(self.truth, shape[:2], self.problems)
            joint_names(self.truth, shape[1], self.declared, self.problems)
            self._rate()

    def attributes(self) -> dict[str, Any]:
        """Give the attributes of :class:`posecal.data.pose_data.PoseData`, ordered as :func:`match_poses` says.

        Raises
        ------
        PoseDataError
            For everything that does not fit, all at once.
        """
        hypotheses, truth, problems = self.hypotheses, self.truth, self.problems
        n, m, k, d = self.shape
        unit, factor, true_factor = self._quantities()
        rows, true_rows = self._frames()
        true_names, columns, true_columns = self._joints()
        stored = self.layouts[1].read(truth.array, np.arange(self.true_shape[0]))
        columns_differ = d != self.true_shape[2]
        if beside := self._columns_beside(stored):
            problems += beside
        elif columns_differ:
            problems.append(f"{hypotheses.name} has D = {d} and {truth.name} {self.true_shape[2]}; expected as many.")
        is_matched = not problems
        own_members = read_members(hypotheses, (m, k), problems, self.clip_length)
        true_members = read_members(truth, self.true_shape[:2], problems, self.clip_length)
        self.remarks += unread_remarks(hypotheses, (m, k)) + unread_remarks(truth, self.true_shape[:2])
        (scores, weights), fps = (self._of_hypotheses(name) for name in ("scores", "weights")), self._rate()
        if (count := self.declared.n_hypotheses) is not None:
            which, expected = option("n_hypotheses"), f"1 to N = {n}, the hypotheses of {hypotheses.name}"
            n = int(attempt(problems, checked_number, count, which, range(1, n + 1).__contains__, expected) or n)
        if not is_matched:
            raise_all(problems)

        members, others = own_members.select(rows, columns), true_members.select(true_rows, true_columns)
        known = both(members.valid, others.valid)
        if known is not None:
            counts = np.asarray(known.any(axis=1))
            self._remark_invalid(known, counts, true_rows)
            rows, true_rows, known = rows[counts], true_rows[counts], known[counts]
            members, others = own_members.select(rows, columns), true_members.select(true_rows, true_columns)
        y = in_millimetres(stored, true_factor)
        in_order = len(true_names) == k and np.array_equal(columns, np.arange(k))
        stored_parents = (truth.name, truth.parents), (hypotheses.name, hypotheses.parents if in_order else None)
        own = attempt(problems, self.declared.skeleton_of, true_names, *stored_parents)
        parents, own_root = ((), None) if own is None else (own.parents, own.root)
        declared_root = self.declared.root_joint
        if declared_root is None and own_root is None and unit != "mm":
            declared_root = "none"  # of positions alone is the root a joint's by itself
        chosen = attempt(problems, choose_root, declared_root, true_names, y, parents, own_root)
        labels, numbered = self._merged(members.labels, others.labels, true_rows)
        if chosen is None:
            raise_all(problems)
        assert chosen is not None
        order = true_rows
        if truth.frame_id is not None and self.clip_length is None and "sequence" in labels:
            ordered = order_by_number(truth.frame_id[true_rows], labels["sequence"])
            if ordered is not None:
                by_number, order, remarks = ordered
                self.remarks += remarks
                rows, true_rows = rows[by_number], true_rows[by_number]
                known = None if known is None else known[by_number]
                labels = {name: values[by_number] for name, values in labels.items()}
                members, others = own_members.select(rows, columns), true_members.select(true_rows, true_columns)
        (of_all, remark), root = chosen, part_of_root(chosen[0], true_columns.tolist())
        counts_at = both(known, others.where)
        hypotheses = with_counts(hypotheses, rows, columns, counts_at)
        predicted = ArrayHypotheses(hypotheses.array, self.layouts[0], rows, columns, factor, n)
        lost = root_name(of_all, true_names)
        if of_all is not None and root is None and declared_root is None:  # they may have another root
            some = predicted.read(0, 64)[:8].reshape(-1, *predicted.read(0, 1).shape[2:])
            root, remark = choose_root(None, tuple(true_names[column] for column in true_columns), some)
            remark = f"{hypotheses.name} lacks the root {lost}; {remark}"
        if of_all is not None and root is None:
            with np.errstate(invalid="ignore"):  # joints that don't count may hold anything
                y = y - origin(y, of_all)
            remark = f"{hypotheses.name} lacks the root {lost}; its positions are taken as relative to it."
        self.remarks += [remark] if remark else []
        is_drawn = isinstance(hypotheses.array, DrawnHypotheses)
        frames = self._frame_names(true_rows) if is_drawn or hypotheses.log_prob is not None else []
        matched = np.ascontiguousarray(y[true_rows][:, true_columns])
        names = tuple(true_names[k] for k in true_columns)
        place = counts_at, rows, columns, frames, root, factor, problems
        if is_drawn:
            log_prob, dimensions, remarks = stated_log_density(hypotheses, matched, names, unit, *place)
        else:
            log_prob, dimensions, remarks = log_density(hypotheses, self.shape, *place)
        self.remarks += remarks
        frame_id = true_rows.astype(str) if truth.frame_id is None else truth.frame_id[true_rows]
        if weights is not None:
            weights = attempt(problems, checked_weights, weights[:, rows], n, f"{hypotheses.name}: weights", frame_id)
        labels = with_horizons(labels, order, true_rows, self.clip_length, fps)
        place_of_truth = truth, true_rows, true_columns, d, true_factor
        clips = describe_clips(labels, numbered, self.clip_length, self.true_shape[0], *place_of_truth, problems)
        return {
            "hypotheses": predicted,
            "truth": matched,
            "unit": unit,
            "joints": names,
            "parents": parents_among(parents, true_columns.tolist()) if parents else (),
            "root": root,
            "frame_id": frame_id,
            "has_frame_id": truth.frame_id is not None,
            "order": order,
            "labels": labels,
            "clips": clips,
            "occluded": members.occluded if others.occluded is None else others.occluded,
            "scores": None if scores is None else scores[:n, rows],
            "log_prob": log_prob,
            "dimensions": dimensions,
            "weights": weights,
            "fps": fps,
            "names": (hypotheses.name, truth.name),
            "where": counts_at,
            "usable": None,
            "remarks": (*self.remarks, *short_clip_remarks(clips, labels.get("clip"))),
            "reference": None,
        }

    def _columns_beside(self, truth: npt.NDArray[np.generic]) -> list[str]:
        """Say which of the two hold something beside coordinates; the hypotheses are looked at where it may be so."""
        (layout, true_layout), first = self.layouts, np.arange(min(8, self.shape[1]))
        of_truth = column_problem(self.truth.name, truth, "truth_axes", true_layout.text)
        if not of_truth and self.shape[3] <= 3:
            return []
        hypotheses = layout.read(self.hypotheses.array, first)
        found = column_problem(self.hypotheses.name, hypotheses, "axes", layout.text), of_truth
        return [problem for problem in found if problem]

    def _of_hypotheses(self, name: str) -> FloatArray | None:
        """Give what is declared of each hypothesis, (N, M); None where nothing is, or it has another shape."""
        values, which = getattr(self.hypotheses, name), f"{self.hypotheses.name}: {name}"
        if values is None:
            return None
        return attempt(self.problems, poses_last, values, self.shape[:2], self.layouts[0].text, which)

    def _rate(self) -> float | None:
        """Give the frames per second."""
        fps = self.hypotheses.fps if self.truth.fps is None else self.truth.fps
        expected = "frames per second, above 0"
        return None if fps is None else attempt(self.problems, checked_number, fps, "fps", _is_rate, expected)

    def _remark_invalid(self, known: BoolArray, counts: BoolArray, rows: Rows) -> None:
        """Say how many joints and poses are not valid."""
        poses, joints = int((~counts).sum()), int((~known[counts]).sum())
        if not counts.any():
            raise PoseDataError(f"valid: no joint of {self.truth.name} is valid; expected some.")
        if poses:
            names = self._frame_names(rows[~counts])
            first = Example.of(names)
            self.remarks.append(
                Remark("valid: ", Count(poses, "frame"), " without a valid joint (first: ", first, "); left out.")
            )
        if joints:
            self.remarks.append(Remark("valid: ", Count(joints, "joint is", "joints are"), " not valid; left out."))

    def _frame_names(self, rows: Rows) -> list[str]:
        """Give the names of some frames of the truth, or their numbers where they have none."""
        names = self.truth.frame_id
        return [str(name) for name in (rows if names is None else names[rows]).tolist()]

    def _quantities(self) -> tuple[str, float, float]:
        """The unit that is measured in, and the factors of both; ``unit`` is for what declares none, or must agree."""
        name, declared = "truth_unit", self.declared.truth_unit
        if declared is None and not (self.truth.unit is not None and self.hypotheses.unit is None):
            name, declared = "unit", self.declared.unit
        stored = {poses.unit for poses in (self.hypotheses, self.truth)} & {*OTHERS}
        otherwise = stored.pop() if len(stored) == 1 else "mm"  # an angle is compared with angles
        one = attempt(self.problems, quantity_of, self.hypotheses, "unit", self.declared.unit, otherwise)
        other = attempt(self.problems, quantity_of, self.truth, name, declared, otherwise)
        (unit, factor), (true_unit, true_factor) = one or ("mm", 1.0), other or ("mm", 1.0)
        if unit != true_unit and one and other:
            self.problems.append(
                f"{self.hypotheses.name} is in {unit or 'no unit'} and {self.truth.name} in {true_unit or 'no unit'}; "
                "expected one quantity. Declare the unit of what declares none."
            )
        return unit, factor, true_factor

    def _frames(self) -> tuple[Rows, Rows]:
        """Match frames by id, or by their order where one of the two has no ids."""
        hypotheses, truth = self.hypotheses, self.truth
        sizes, before = (self.shape[1], self.true_shape[0]), len(self.problems)
        fitting = plausible_layouts(hypotheses.array.shape, self.true_shape)
        fitting = [text for text in fitting if text != self.layouts[0].text]
        hint = f" The shapes fit {option('axes', fitting[0])}." if fitting else ""
        for poses, size in zip((hypotheses, truth), sizes, strict=True):
            if poses.frame_id is not None and len(poses.frame_id) != size:
                number = len(poses.frame_id)
                self.problems.append(f"{poses.name}: {number:,} frame_id for {size:,} poses; expected one each.{hint}")
        if hypotheses.frame_id is None or truth.frame_id is None:
            if sizes[0] != sizes[1]:
                without = " and ".join(poses.name for poses in (hypotheses, truth) if poses.frame_id is None)
                self.problems.append(
                    f"{hypotheses.name} has M = {sizes[0]:,} poses and {truth.name} {sizes[1]:,}; expected as many."
                    f"{hint} Give both a frame_id to match them by ({without} without)."
                )
            self.remarks += frame_id_remarks(hypotheses, truth)
            return np.arange(sizes[0]), np.arange(sizes[1])
        ids, true_ids = hypotheses.frame_id.tolist(), truth.frame_id.tolist()
        for poses, names in ((hypotheses, ids), (truth, true_ids)):
            if repeated := _repeated(names):
                self.problems.append(
                    f"{poses.name} has {len(repeated):,} of {len(names):,} frame_id more than once "
                    f"(first: {first_few(repeated)}). Give each frame once."
                )
        row = {name: number for number, name in enumerate(ids)}
        known, is_whole = set(true_ids), self.declared.missing != "part"
        shared = [number for number, name in enumerate(true_ids) if name in row]
        if not shared and len(self.problems) == before:
            self._nothing_shared("frame_id", ids, true_ids)
        for poses, other, names, lacking in (
            (hypotheses, truth, true_ids, [name for name in true_ids if name not in row] * is_whole),
            (truth, hypotheses, ids, [name for name in ids if name not in known]),
        ):
            lacks = f"{poses.name} lacks {len(lacking):,} of the {len(names):,} frames of {other.name}"
            if lacking and self.declared.missing == "skip":
                self.remarks.append(f"{lacks}: skipped.")
            elif lacking and shared:
                skip = option("missing", "skip")
                self.problems.append(f"{lacks} (first: {first_few(lacking)}). Pass {skip} to score the rest.")
        return np.array([row[true_ids[m]] for m in shared], dtype=np.intp), np.array(shared, dtype=np.intp)

    def _nothing_shared(self, what: str, names: Sequence[str], true_names: Sequence[str]) -> None:
        self.problems.append(
            f"{self.hypotheses.name} and {self.truth.name} have no {what} in common ({first_few(names)} against "
            f"{first_few(true_names)}); expected the same names."
        )

    def _joints(self) -> tuple[Names, Rows, Rows]:
        """Name joints, and match them by name, or by their order where the hypotheses' have none."""
        size, true_size = self.shape[2], self.true_shape[1]
        attempt(self.problems, refuse_other_names, self.declared, self.hypotheses, self.truth)
        names = joint_names(self.hypotheses, size, self.declared, self.problems)
        true_names = joint_names(self.truth, true_size, self.declared, self.problems)
        true_names = true_names or (names if size == true_size else None) or numbered(true_size)
        common = option("shared_joints", "common")
        if names is None:
            if size != true_size:
                self.problems.append(
                    f"{self.hypotheses.name} has K = {size} joints and {self.truth.name} {true_size}; expected as "
                    f"many, or joints named in both and {common}."
                )
            self.remarks += remarks_on_names(true_names, ALL_NAMES) if self.truth.joints else []
            return true_names, np.arange(size), np.arange(size)
        matched, ambiguous = match_joints(true_names, names)
        if ambiguous:
            self.problems.append(
                f"{self.truth.name} and {self.hypotheses.name} name some joints ambiguously: "
                f"{first_few(ambiguous)}; expected names that mean one joint. Rename them in one of the two."
            )
            return true_names, np.arange(size), np.arange(true_size)
        shared, columns = sorted(matched), [matched[k] for k in sorted(matched)]
        lacking = [name for k, name in enumerate(true_names) if k not in matched]
        beyond = [name for k, name in enumerate(names) if k not in columns]
        for some in dict.fromkeys((true_names, names)):
            self.remarks += remarks_on_names(some, ALL_NAMES)
        self.remarks += remarks_on_matched(true_names, names, matched)
        for poses, missing in ((self.hypotheses, lacking), (self.truth, beyond)):
            if missing and shared and self.declared.shared_joints == "same":
                self.problems.append(
                    f"{poses.name} lacks {len(missing)} of the other's joints ({first_few(missing)}). "
                    f"Pass {common} to score the shared ones."
                )
        if not shared:
            self._nothing_shared("joint", names, true_names)
        elif (lacking or beyond) and self.declared.shared_joints == "common":
            self.remarks.append(f"{len(shared)} joints are in both; left out: {first_few([*lacking, *beyond], 5)}.")
        return true_names, np.array(columns, dtype=np.intp), np.array(shared, dtype=np.intp)

    def _merged(self, labels: Labels, true_labels: Labels, true_rows: Rows) -> tuple[Labels, Names]:
        """Put the labels of matched frames together, with those of clips; name the labels that are numbers of clips."""
        for name in true_labels:
            different = int((labels[name] != true_labels[name]).sum()) if name in labels else 0
            if different:
                self.problems.append(
                    f"{self.hypotheses.name} and {self.truth.name} differ in {name} of {different:,} of "
                    f"{len(true_rows):,} frames. Are they in the same order? A frame_id of both matches them."
                )
        return with_clip_labels({**true_labels, **labels}, true_rows, self.clip_length)


def empty_problem(poses: StoredPoses) -> str:
    """Say that poses have an axis of length 0."""
    return f"{poses.name}: nothing in it; its shape is {poses.array.shape}."


def numbered(size: int) -> Names:
    """Name K joints by their number."""
    return tuple(f"joint {k}" for k in range(size))


def _repeated(names: Sequence[str]) -> list[str]:
    return [name for name, count in Counter(names).items() if count > 1]


def _is_rate(fps: float) -> bool:
    return 0 < fps < math.inf
