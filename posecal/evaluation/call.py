"""Evaluation in one call."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any, Literal

import numpy.typing as npt

from posecal.calibration.rank_tests import PreRank
from posecal.data.pose_data import PoseData
from posecal.engine.protocol import Protocol
from posecal.errors import PosecalError, PoseDataError, attempt, raise_all
from posecal.evaluation.batches import Evaluation
from posecal.evaluation.sources import Progress, Source, as_pose_data
from posecal.report.report import Report
from posecal.stats.skill import climatology, with_reference


def evaluate(
    hypotheses: Source | PoseData,
    truth: Source | None = None,
    /,
    *,
    where: npt.ArrayLike | None = None,
    joints: Sequence[str] | str | None = None,
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
    unit: str | None = None,
    truth_unit: str | None = None,
    axes: str | None = None,
    truth_axes: str | None = None,
    missing: Literal["error", "skip", "part"] = "error",
    shared_joints: Literal["same", "common"] = "same",
    n_hypotheses: int | None = None,
    skeleton: object = None,
    draws: int | None = None,
    seed: int | None = None,
    by: Sequence[str] | str = (),
    metrics: str | Sequence[str] | None = None,
    reference: Literal["climatology"] | Source | PoseData | None = None,
    preranks: Mapping[str, PreRank] | None = None,
    protocol: Protocol | str | None = None,
    threads: int | None = None,
    progress: Progress | None = None,
    gallery: bool = True,
) -> Report:
    """Evaluate hypotheses against the truth.

    Parameters
    ----------
    hypotheses : array (N, M, K, D), path, GaussianPrediction or PoseData
        Hypotheses, in ``unit`` and in the layout ``axes``; or a file that declares them itself; or what they are drawn
        from; or pose data, then without ``truth`` and without the options that describe data.
    truth : array (M, K, D) or path
        True poses, likewise.
    where : bool array (M, K) or (M,), optional
        The joints that count.
    joints : sequence of str, optional
        K names, or a joint set, where the data name none; they give the skeleton, the root and the joint sets.
    root_joint : str or int, optional
        What to subtract from every pose: a joint by name or index, a midpoint such as ``LHip+RHip``, one of these for
        each part (``RWrist,LWrist``), or ``none``. By default the hip, the one joint whose truth is 0 throughout, the
        root of the joint set, or the midpoint of the hips.
    labels : mapping, optional
        Labels of the poses, such as ``sequence`` or ``action``: an array (M,), or one value for all poses.
    occluded : bool array (M, K), optional
        The joints whose keypoints were not seen; instead of a file's.
    scores : array (N, M), optional
        The model's score of each hypothesis, (M, N) where ``axes`` has M first; instead of a file's.
    log_prob : array (M,), optional
        The model's log density at the true pose, nats, of coordinates in ``unit``; instead of a file's.
    dimensions : int, optional
        The number of coordinates that this density is over; those of the joints that are not the root by default.
    weights : array (N, M), optional
        The weight of each hypothesis, of sum 1 for each pose, 0 for one that is absent; likewise. Every number counts
        hypotheses by them.
    fps : float, optional
        Frames per second; instead of a file's.
    observed : array (M, K, D), optional
        The last observed pose before each of M clips, in the joints, order and unit of the truth; instead of a file's.
    frame_id, truth_frame_id : arrays (M,), optional
        Names of the frames, by which hypotheses and truth are joined; one of them is for both.
    unit, truth_unit : str, optional
        Of data that declare none: ``mm``, ``cm``, ``m``, or the millimetres in one unit; ``deg`` or ``rad`` for angles,
        ``px``, or ``none``. ``unit`` is for both unless ``truth_unit`` is given; millimetres by default, and refused
        where they can't be.
    axes, truth_axes : str, optional
        Layouts of data that declare none, such as ``MNKD``; ``NMKD`` and ``MKD`` by default.
    missing : str
        ``error``, ``skip`` to evaluate the frames that both have, or ``part`` where the hypotheses are of some frames
        of the truth.
    shared_joints : str
        ``same``, or ``common`` to evaluate the joints that both have.
    n_hypotheses : int, optional
        Take only the first so many hypotheses.
    skeleton : path, mapping or str, optional
        Names, parents and root of the joints; see :class:`posecal.PoseData`.
    draws, seed : int, optional
        How many hypotheses are drawn from distributions, 200 by default, and the seed, 0 by default.
    by : sequence of str
        Labels to group by; one alone may be given as it is. ``occlusion`` separates occluded from visible joints,
        ``predicted_spread`` cuts terciles of the predicted spread.
    metrics : str or sequence of str, optional
        Names of metrics, and the words default, rank_tests, scores and all.
    reference : str, array, path or PoseData, optional
        What skill scores are relative to: ``climatology``, or hypotheses of another model for the same poses.
    preranks : mapping of callables, optional
        Rank tests of one's own, by name: each from a pool of poses (n, K, D), the truth last, to a number of each.
    protocol : Protocol or str, optional
        The options, or the name of a preset.
    threads : int, optional
        One per core by default.
    progress : callable, optional
        Called with the number of poses that are done.
    gallery : bool
        Whether the report keeps some twelve poses with some of their hypotheses, those of the worst sequences, for the
        pictures of its page. A saved result holds them too, but for ``report.save(path, gallery=False)``.

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

    See Also
    --------
    Evaluation : the same in batches.

    Examples
    --------
    Two hypotheses of three poses with two joints; every truth is 3 mm from the nearer one at one joint.

    >>> import numpy as np
    >>> hypotheses = np.zeros((2, 3, 2, 3))
    >>> hypotheses[0, :, 1], hypotheses[1, :, 1] = [3, 0, 0], [0, 5, 0]
    >>> report = evaluate(hypotheses, np.zeros((3, 2, 3)), unit="mm")
    >>> report["min_mpjpe"]
    1.5
    """
    described = {
        "where": where,
        "joints": joints,
        "root_joint": root_joint,
        "labels": labels,
        "occluded": occluded,
        "scores": scores,
        "log_prob": log_prob,
        "dimensions": dimensions,
        "weights": weights,
        "fps": fps,
        "observed": observed,
        "frame_id": frame_id,
        "truth_frame_id": truth_frame_id,
        "unit": unit,
        "truth_unit": truth_unit,
        "axes": axes,
        "truth_axes": truth_axes,
        "missing": missing,
        "shared_joints": shared_joints,
        "n_hypotheses": n_hypotheses,
        "skeleton": skeleton,
        "draws": draws,
        "seed": seed,
    }
    problems: list[str | PosecalError] = []
    options: dict[str, Any] = {"by": by, "metrics": metrics, "preranks": preranks, "protocol": protocol}
    options |= {"threads": threads, "gallery": gallery}
    evaluation = attempt(problems, partial(Evaluation, **options))
    data = attempt(problems, as_pose_data, hypotheses, truth, described)
    raise_all(problems)
    assert evaluation is not None
    assert data is not None
    if reference is not None:
        data = with_reference(data, _reference(reference, data, truth, described))
    evaluation.add(data, progress=progress, complete=True)
    return evaluation.compute()


def _reference(
    reference: Source | PoseData, data: PoseData, truth: Source | None, options: Mapping[str, Any]
) -> PoseData:
    """Give the hypotheses that skill scores are relative to, as pose data."""
    if isinstance(reference, PoseData):
        return reference
    if isinstance(reference, str) and reference == "climatology":
        return climatology(data)
    if truth is None:
        raise PoseDataError('reference: expected "climatology" or PoseData where the data are PoseData.')
    own = dict.fromkeys(("scores", "weights", "log_prob", "dimensions"))  # of the model
    return as_pose_data(reference, truth, {**options, **own})
