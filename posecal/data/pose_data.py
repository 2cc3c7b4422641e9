"""Data to be evaluated: hypotheses and truth, matched by frame and joint, in millimetres."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import partial
from typing import Any, Literal, Self, TypeVar

import numpy as np
import numpy.typing as npt

from posecal.data.arrays import (
    BoolArray,
    FloatArray,
    as_array,
    as_label_arrays,
    as_labels,
    as_marks,
    as_scores,
    real_array,
)
from posecal.data.checks import FRAMES, check_units
from posecal.data.clips import Clips
from posecal.data.declarations import Declarations
from posecal.data.degenerate import third_column_remarks
from posecal.data.draws import DrawnHypotheses, with_draws
from posecal.data.fitted_poses import fitted_remarks
from posecal.data.gaussian import GaussianPrediction
from posecal.data.layout import HYPOTHESES
from posecal.data.log_density import as_dimensions, as_log_prob
from posecal.data.match import Matcher
from posecal.data.read import read_poses
from posecal.data.root import AnyRoot
from posecal.data.stored_poses import Hypotheses, Labels, Rows, StoredPoses
from posecal.data.weights import as_weights
from posecal.errors import PosecalError, PoseDataError, attempt, raise_all

T = TypeVar("T")
Source = npt.ArrayLike | str | os.PathLike[str] | GaussianPrediction


@dataclass(frozen=True, init=False, eq=False, repr=False)
class PoseData:
    """M poses with N hypotheses each and their truth: in mm, in one order of frames and joints.

    Parameters
    ----------
    hypotheses : array_like (N, M, K, D), path or GaussianPrediction
        Hypotheses, in another layout if ``axes`` says so: NumPy, PyTorch or JAX arrays, or lists; or an ``.npz`` or
        ``.npy`` file, which is read some poses at a time. Of distributions they are drawn, as they are read.
    truth : array_like (M, K, D) or path
        True poses, likewise.
    where : bool array (M, K) or (M,), optional
        The joints that count, of the truth.
    joints : str or sequence of str, optional
        K names, or a joint set, where the data name none; skeleton and root follow from them.
    root_joint : str or int, optional
        What to subtract from every pose: a joint by name or index, a midpoint such as ``LHip+RHip``, one of these for
        each part (``RWrist,LWrist``), or ``none``. By default the hip, the one joint whose truth is 0 throughout, the
        root of the joint set, or the midpoint of the hips.
    labels : mapping, optional
        Labels of the truth's poses, such as ``sequence`` and ``action``: arrays (M,), or one value for all poses; of C
        clips of T frames (``axes`` with a T) also (C,) or (C, T), and masks (C, T, K). They replace labels of a file.
    occluded : bool array (M, K), optional
        The joints whose keypoints were not visible, of the truth; instead of a file's.
    scores : array (N, M), optional
        The model's score of each hypothesis, (M, N) where ``axes`` has M first; instead of a file's.
    log_prob : array (M,), optional
        The model's log density at the true pose, nats, of coordinates in ``unit``; instead of a file's.
    dimensions : int, optional
        The number of coordinates that this density is over; those of the joints that are not the root by default.
    weights : array (N, M), optional
        The weight of each hypothesis, of sum 1 for each pose, 0 for one that is absent; likewise.
    fps : float, optional
        Frames per second; instead of a file's.
    observed : array (M, K, D), optional
        The last observed pose before each of M clips, in the joints, order and unit of the truth; instead of a file's.
    frame_id : array (M,), optional
        Names of the frames, of both; of the hypotheses only where the truth has its own. Frames are matched by them.
    truth_frame_id : array (M,), optional
        Names of the truth's frames.
    unit, truth_unit : str or float, optional
        Of what declares none: ``mm``, ``cm``, ``m``, or the millimetres in one unit; ``deg`` or ``rad`` for angles,
        ``px``, or ``none``. mm by default; ``unit`` is for both unless ``truth_unit`` is given.
    axes, truth_axes : str, optional
        Layouts of what declares none, such as ``MNKD`` and ``MDK``.
    missing : str
        ``error``, ``skip`` to keep the frames that both have, or ``part`` where the hypotheses are of some frames
        of the truth.
    shared_joints : str
        ``same``, or ``common`` to keep the joints that both have.
    n_hypotheses : int, optional
        How many hypotheses are read, the first ones; all by default.
    draws, seed : int, optional
        How many hypotheses are drawn from distributions, 200 by default, and the seed, 0 by default.
    skeleton : path, mapping or str, optional
        Names, parents and root of the joints: a ``.json`` or ``.toml`` file, or a mapping with ``names``, ``parents``
        and perhaps ``root``; or a joint set. By default they follow from the names, or from a member ``parents``.

    Attributes
    ----------
    hypotheses : Hypotheses
        Read some poses at a time.
    truth : array (M, K, D)
        True poses, in ``unit``.
    unit : str
        ``mm``, ``deg``, ``px``, or empty.
    joints : tuple of str
        K names, as :mod:`posecal.data.skeleton` spells them; numbered where there are none.
    parents : tuple of int
        The user's own skeleton: the number of each joint's parent, -1 for a root; empty where it follows from names.
    root : int, Root or None
        The joint to subtract from every pose; see :mod:`posecal.data.root` for midpoints and parts.
    frame_id : array of str (M,)
        Name of each frame.
    has_frame_id : bool
        Whether these are names that the user gave; else they are the rows of the truth.
    order : array of int (M,)
        A rising number of each pose: two poses are consecutive where these are. The index among the truth's frames as
        stored, or what :mod:`posecal.data.frame_numbers` gives.
    labels : mapping of arrays of str (M,)
        Other properties of each pose.
    clips : Clips or None
        What clips of poses have in common; None without any.
    occluded : bool array (M, K) or None
        The joints whose keypoints were not visible.
    scores : array (N, M) or None
        The model's score of each hypothesis.
    log_prob : array (M,) or None
        The model's log density at the true pose, nats, of coordinates in ``unit``.
    dimensions : int
        The number of coordinates that it is over; 0 without it.
    weights : array (N, M) or None
        The weight of each hypothesis, of sum 1 for each pose; None where all are equal.
    fps : float or None
        Frames per second.
    names : tuple of two str
        What messages call the hypotheses and the truth.
    where : bool array (M, K) or None
        The joints that count.
    usable : bool array (M, K) or None
        The joints that poses are aligned by, where some of them don't count; by default those that count.
    remarks : tuple of str
        What a careful reader should know about the data, with options as :func:`posecal.errors.option` gives them.
    reference : PoseData or None
        The same poses with other hypotheses, that skills are relative to.

    Raises
    ------
    PoseDataError
        For everything that does not fit, all at once.
    PoseFileError
        For files that can't be read.

    Notes
    -----
    A layout is never guessed: where N = M and ``axes`` does not say which is which, the data are refused.

    Examples
    --------
    >>> hypotheses, truth = np.full((2, 3, 17, 3), 0.1), np.zeros((3, 17, 3))
    >>> data = PoseData(hypotheses, truth, unit="m", joints="h36m-17", labels={"action": "walk"})
    >>> data
    PoseData('hypotheses', 'truth': N=2, M=3, K=17, D=3)
    >>> data.joints[data.root], float(data.hypotheses.read(0, 1).max()), data.labels["action"].tolist()
    ('Hip', 100.0, ['walk', 'walk', 'walk'])
    """

    hypotheses: Hypotheses
    truth: FloatArray
    unit: str
    joints: tuple[str, ...]
    parents: tuple[int, ...]
    root: AnyRoot
    frame_id: npt.NDArray[np.str_]
    has_frame_id: bool
    order: Rows
    labels: Labels
    clips: Clips | None
    occluded: BoolArray | None
    scores: FloatArray | None
    log_prob: FloatArray | None
    dimensions: int
    weights: FloatArray | None
    fps: float | None
    names: tuple[str, str]
    where: BoolArray | None
    usable: BoolArray | None
    remarks: tuple[str, ...]
    reference: PoseData | None

    def __init__(
        self,
        hypotheses: Source,
        truth: Source,
        /,
        *,
        where: npt.ArrayLike | None = None,
        joints: Sequence[str] | None = None,
        root_joint: str | int | None = None,
        labels: Mapping[str, npt.ArrayLike] | None = None,
        occluded: npt.ArrayLike | None = None,
        scores: npt.ArrayLike | None = None,
        log_prob: npt.ArrayLike | None = None,
        dimensions: int | None = None,
        weights: npt.ArrayLike | None = None,
        fps: float | None = None,
        observed: npt.ArrayLike | None = None,
        frame_id: npt.ArrayLike | None = None,
        truth_frame_id: npt.ArrayLike | None = None,
        unit: str | float | None = None,
        truth_unit: str | float | None = None,
        axes: str | None = None,
        truth_axes: str | None = None,
        missing: Literal["error", "skip", "part"] = "error",
        shared_joints: Literal["same", "common"] = "same",
        n_hypotheses: int | None = None,
        skeleton: object = None,
        draws: int | None = None,
        seed: int | None = None,
    ) -> None:
        problems: list[str | PosecalError] = []
        declared: dict[str, Any] = {"axes": axes, "truth_axes": truth_axes, "unit": unit, "truth_unit": truth_unit}
        declared |= {"joints": joints, "root_joint": root_joint, "missing": missing, "shared_joints": shared_joints}
        declared |= {"n_hypotheses": n_hypotheses, "skeleton": skeleton}
        declared = {name: value for name, value in declared.items() if value is not None}
        possible, declarations = declared, attempt([], partial(Declarations, **declared))
        if declarations is None:
            possible = {k: v for k, v in declared.items() if attempt(problems, partial(Declarations, **{k: v}))}
        wrong = declared.keys() - possible.keys()
        predicted = attempt(problems, read_poses, hypotheses, "hypotheses")
        true = attempt(problems, read_poses, truth, "truth")
        arguments: dict[str, tuple[Callable[..., Any], object]] = {
            "labels": (as_label_arrays, labels),
            "occluded": (as_marks, occluded),
            "scores": (as_scores, scores),
            "log_prob": (as_log_prob, log_prob),
            "dimensions": (as_dimensions, dimensions),
            "weights": (as_weights, weights),
            "where": (as_array, where),
            "observed": (real_array, observed),
            "frame_id": (partial(as_labels, or_clips=True), frame_id),
            "truth_frame_id": (partial(as_labels, or_clips=True), truth_frame_id),
        }
        arrays: dict[str, Any] = {}
        for name, (convert, value) in arguments.items():
            if value is not None:
                arrays[name] = attempt(problems, convert, value, name)
        if predicted is None or true is None or wrong & {"axes", "truth_axes"}:
            raise_all(problems)
        possible |= dict.fromkeys(wrong & {"unit", "truth_unit"}, "mm")
        assert predicted is not None
        assert true is not None
        predicted = attempt(problems, with_draws, predicted, draws, seed) or predicted
        ids, own_labels = arrays.get("frame_id"), arrays.get("labels") or {}
        predicted = replace(
            predicted,
            frame_id=predicted.frame_id if ids is None else ids,
            **{name: arrays[name] for name in ("scores", "weights", "log_prob", "dimensions") if name in arrays},
        )
        true = replace(
            true,
            frame_id=arrays.get("truth_frame_id", ids if true.frame_id is None else true.frame_id),
            labels={**true.labels, **own_labels},
            required_labels=true.required_labels | own_labels.keys(),
            marks=true.marks if arrays.get("occluded") is None else {"occluded": arrays["occluded"]},
            where=arrays.get("where"),
            observed=arrays.get("observed", true.observed),
            fps=true.fps if fps is None else fps,
        )
        matched = match_poses(predicted, true, declarations or Declarations(**possible), problems)
        if not isinstance(predicted.array, DrawnHypotheses) and (draws, seed) != (None, None):
            remark = f"{predicted.name} holds hypotheses: none are drawn, whatever draws and seed are."
            matched = matched.replace(remarks=(*matched.remarks, remark))
        vars(self).update(vars(matched))

    def __repr__(self) -> str:
        sizes = ", ".join(f"{letter}={size}" for letter, size in zip(HYPOTHESES, self.shape, strict=True))
        return f"PoseData({self.names[0]!r}, {self.names[1]!r}: {sizes})"

    @property
    def shape(self) -> tuple[int, int, int, int]:
        """(N, M, K, D)."""
        m, k, d = self.truth.shape
        return self.hypotheses.n_hypotheses, m, k, d

    def replace(self, **changes: Any) -> Self:
        """Copy the data with some attributes changed."""
        unknown = changes.keys() - {field.name for field in fields(self)}
        if unknown:
            raise TypeError(f"PoseData has no attribute {sorted(unknown)[0]!r}")
        return _with_attributes(type(self), **{**vars(self), **changes})

    def select(self, poses: npt.ArrayLike) -> Self:
        """Keep some poses, by their numbers or by a mask (M,)."""
        try:
            rows = np.arange(len(self.truth))[as_array(poses, "poses")]
        except IndexError:
            raise PoseDataError(
                f"poses: {poses!r}; expected numbers below M = {len(self.truth):,}, or a mask (M,)."
            ) from None
        part = {
            name: None if values is None else values[..., rows] if name in ("scores", "weights") else values[rows]
            for name, values in vars(self).items()
            if name in ("truth", "frame_id", "order", "occluded", "scores", "weights", "log_prob", "where", "usable")
        }
        return self.replace(
            **part,
            hypotheses=self.hypotheses.select(rows),
            labels={name: values[rows] for name, values in self.labels.items()},
            reference=None if self.reference is None else self.reference.select(rows),
        )


def _with_attributes(kind: type[T], **attributes: Any) -> T:
    """Make pose data of its attributes."""
    data = object.__new__(kind)
    vars(data).update(attributes)
    return data


def match_poses(
    hypotheses: StoredPoses,
    truth: StoredPoses,
    declarations: Declarations | None = None,
    problems: Iterable[str | PosecalError] = (),
) -> PoseData:
    """Match hypotheses with the truth.

    Parameters
    ----------
    hypotheses, truth : StoredPoses
        As stored or passed.
    declarations : Declarations, optional
        What the user declares about them.
    problems : iterable, optional
        What is known to be wrong, to be raised with the rest.

    Returns
    -------
    PoseData
        In the order of the truth's joints, and of its frames: by sequence and number where ``frame_id`` has numbers.

    Raises
    ------
    PoseDataError
        For everything that does not fit, all at once.
    """
    declared = declarations or Declarations()
    matcher = Matcher(hypotheses, truth, declared, problems)
    data = _with_attributes(PoseData, **matcher.attributes())
    some = data.hypotheses.read(0, min(len(data.truth), FRAMES))
    remarks = attempt(matcher.problems, check_units, data, some, hypotheses.unit, truth.unit, declared) or []
    raise_all(matcher.problems)
    if (truth.unit or declared.truth_unit or declared.unit) == "m":
        remarks += third_column_remarks(truth.name, data.truth / 1000, "truth_axes", "MKC")
    remarks += fitted_remarks(hypotheses.recalibrated_on, data.truth, hypotheses.name)
    return data.replace(remarks=(*data.remarks, *remarks))
