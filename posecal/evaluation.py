"""What do two arrays, or two files, say about a model? The front door of the library."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from posecal.data.layout import HYPOTHESES, TRUTH, MemoryArray
from posecal.data.match import Declarations, join
from posecal.data.pose_data import StoredPoses
from posecal.data.read import Role, as_labels, as_marks, as_scores, read_poses
from posecal.data.skeleton import joint_set
from posecal.engine.accumulate import accumulate
from posecal.engine.protocol import Protocol, preset
from posecal.errors import PoseDataError, raise_all
from posecal.report.report import Report

__all__ = ["evaluate"]


def evaluate(
    hypotheses: npt.ArrayLike | str | os.PathLike[str],
    truth: npt.ArrayLike | str | os.PathLike[str],
    /,
    *,
    where: npt.ArrayLike | None = None,
    joints: Sequence[str] | str | None = None,
    root_joint: str | None = None,
    labels: Mapping[str, npt.ArrayLike] | None = None,
    occluded: npt.ArrayLike | None = None,
    scores: npt.ArrayLike | None = None,
    fps: float | None = None,
    unit: str | None = None,
    axes: str | None = None,
    by: Sequence[str] | str = (),
    protocol: Protocol | str | None = None,
    threads: int | None = None,
) -> Report:
    """Evaluate hypotheses against the truth.

    Parameters
    ----------
    hypotheses : array (N, M, K, D) or path
        Hypotheses, in ``unit`` and in the layout ``axes``; or a file that says all that itself.
    truth : array (M, K, D) or path
        True poses, likewise.
    where : bool array (M, K), optional
        The joints that count.
    joints : sequence of str, optional
        K names, or a joint set, where the data name none; they give the skeleton, the root and the joint sets.
    root_joint : str, optional
        The joint to subtract from every pose: a name, an index, or ``none``. By default the hip, or the one
        unnamed joint whose truth is 0 throughout.
    labels : mapping of arrays (M,), optional
        What is said of each pose: ``sequence``, ``action``, …; beside the labels of a file.
    occluded : bool array (M, K), optional
        The joints whose keypoints were not seen; instead of a file's.
    scores : array (N, M), optional
        The model's score of each hypothesis; instead of a file's.
    fps : float, optional
        Frames per second; instead of a file's.
    unit : str, optional
        Of what declares none: ``mm``, ``cm``, ``m``, or the millimetres in one unit. Arrays are in mm by default.
    axes : str, optional
        The layout of hypotheses that declare none, such as ``MNKD``; ``NMKD`` by default.
    by : sequence of str
        Labels to group by; one alone may be given as it is.
    protocol : Protocol or str, optional
        The options, or the name of a preset.
    threads : int, optional
        How many; by default one per core.

    Returns
    -------
    Report
        The numbers, with their definitions. ``print`` it.

    Raises
    ------
    PoseDataError
        For everything that does not fit, all at once.
    PoseFileError
        For files that can't be read.

    Notes
    -----
    Differs from the published code: see each metric's definition.

    Examples
    --------
    Two hypotheses of three poses with one joint; every truth is 3 mm from the nearer one.

    >>> import numpy as np
    >>> hypotheses = np.zeros((2, 3, 2, 3))
    >>> hypotheses[0, :, 1], hypotheses[1, :, 1] = [3, 0, 0], [0, 5, 0]
    >>> report = evaluate(hypotheses, np.zeros((3, 2, 3)))
    >>> report.value("min_mpjpe")
    1.5
    """
    if isinstance(protocol, str):
        protocol = preset(protocol).protocol
    names = joint_set(joints) if isinstance(joints, str) else None if joints is None else tuple(joints)
    ours = _side("hypotheses", hypotheses, axes or HYPOTHESES, unit, names)
    theirs = _side("truth", truth, TRUTH, unit, names)
    given = {name: as_labels(values, name) for name, values in (labels or {}).items()}
    theirs = replace(theirs, labels={**theirs.labels, **given}, fps=theirs.fps if fps is None else float(fps))
    if occluded is not None:
        theirs = replace(theirs, marks={"occluded": as_marks(occluded, "occluded")})
    if scores is not None:
        ours = replace(ours, scores=as_scores(scores, "scores"))
    pairs = join(ours, theirs, Declarations(axes=axes, root_joint=root_joint))
    raise_all(
        f"labels: {name} has {len(values):,} values for {len(pairs.truth):,} poses; expected one each."
        for name, values in given.items()
        if name not in pairs.labels
    )
    if where is not None:
        mask = np.asarray(where)
        if mask.dtype != bool or mask.shape != pairs.truth.shape[:2]:
            raise PoseDataError(f"where: {mask.dtype} {mask.shape}; expected bool (M, K) = {pairs.truth.shape[:2]}.")
        pairs = replace(pairs, where=mask)
    by = (by,) if isinstance(by, str) else tuple(by)
    return Report(accumulate(pairs, protocol, by=by, threads=threads), by)


def _side(
    role: Role,
    side: npt.ArrayLike | str | os.PathLike[str],
    axes: str,
    unit: str | None,
    joints: tuple[str, ...] | None,
) -> StoredPoses:
    """Open a file, or declare an array; what a file does not say of itself is said here."""
    if isinstance(side, (str, os.PathLike)):
        found = read_poses(side, role)
        return replace(
            found,
            unit=unit if found.unit is None else found.unit,
            joints=joints if found.joints is None else found.joints,
        )
    array = np.asanyarray(side)
    if array.dtype.kind not in "fiu":
        raise PoseDataError(f"{role}: dtype {array.dtype}; expected real numbers such as float32.")
    return StoredPoses(role, MemoryArray(array), axes=axes, unit=unit or "mm", joints=joints)
