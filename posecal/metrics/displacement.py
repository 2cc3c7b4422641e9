"""Errors, diversity and energy score of whole clips, as motion prediction has them: ADE, FDE, APD.

The distance of two poses is the norm over all their joints and coordinates, that of two clips of T frames its mean over
the frames (ADE), the distance at the last frame (FDE), or the norm over all frames as well (APD, energy score).
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import numpy as np
import numpy.typing as npt

from posecal.data.arguments import checked
from posecal.data.arrays import BoolArray, FloatArray
from posecal.engine.block import Block
from posecal.engine.bounds import POSITIVE
from posecal.engine.finish import entry
from posecal.engine.metric import Metric
from posecal.engine.scope import Scope
from posecal.errors import PoseDataError
from posecal.metrics.clips import at_last, clip_statistic, half_distance, is_whole, of_clips, pose_distances
from posecal.metrics.proper import SCORE


def clip_errors(block: Block, body: BoolArray | None, length: int) -> FloatArray:
    """Distance at each frame of the hypothesis whose mean over the clip is smallest, (T,), mm."""
    distances = pose_distances(block, body)
    if not is_whole(block, distances, length):
        return np.full(len(distances), np.nan)
    return np.asarray(distances[:, distances.mean(axis=0).argmin()])


def final_errors(block: Block, body: BoolArray | None, length: int) -> FloatArray:
    """Smallest distance at the last frame, (T,), mm: there, NaN before."""
    distances = pose_distances(block, body)
    return at_last(distances[-1].min() if is_whole(block, distances, length) else np.nan, block)


def pair_distances(block: Block, body: BoolArray | None, length: int) -> FloatArray:
    """Mean distance of two hypotheses, the norm over the whole clip, (T,), mm: at its last frame, NaN before."""
    whole = is_whole(block, pose_distances(block, body), length)
    return at_last(2 * half_distance(block, body) if whole else np.nan, block)


def clip_energies(block: Block, body: BoolArray | None, length: int) -> FloatArray:
    """Fair energy score of the clip, the norm over time, joints and coordinates, (T,), mm: at its last frame."""
    distances = pose_distances(block, body)
    if not is_whole(block, distances, length):
        return at_last(np.nan, block)
    error = np.sqrt((distances**2).sum(axis=0)).mean()
    return at_last(float(error) - half_distance(block, body), block)


def ade(
    hypotheses: npt.ArrayLike,
    truth: npt.ArrayLike,
    /,
    *,
    clip: npt.ArrayLike | None = None,
    where: npt.ArrayLike | None = None,
    root: int | None = None,
    axes: str | None = None,
    unit: str | float | None = None,
) -> FloatArray:
    r"""Average displacement error of each clip, of its best hypothesis: ADE.

    .. math:: \min_n \frac{1}{T} \sum_t \lVert x_{nt} - y_t \rVert_2

    with the norm over all joints and coordinates of a pose.

    Parameters
    ----------
    hypotheses : array (N, M, K, D)
        Hypotheses, mm; or (N, C, T, K, D) with ``axes="NMTKD"``. Hypothesis n is one motion through its clip.
    truth : array (M, K, D)
        True poses, mm, in the order of time; or (C, T, K, D).
    clip : array (M,), optional
        The clip of each pose; by default those of ``axes`` with a T, or else all poses are one.
    where : bool array (M, K) or (M,), optional
        The joints that count.
    root : int, optional
        The joint to subtract from every pose first.
    axes, unit : str, optional
        Such as ``NMTKD`` and ``m``, where the hypotheses are not (N, M, K, D), or both not in mm, or it is not clear.

    Returns
    -------
    array (C,)
        Errors of the clips in their order, mm; lower is better, 0 at best; NaN for a clip with a frame in which no
        joint counts.

    Raises
    ------
    PoseDataError
        For shapes, dtypes, units or values that don't fit, and for clips that come back after another one.

    Notes
    -----
    √K to K times the mean over joints, which other fields call ADE too. Differs from the published code: none.

    See Also
    --------
    fde : At the last frame.
    posecal.metrics.min_mpjpe : Mean over joints, best of each frame.

    References
    ----------
    Yuan and Kitani, arXiv:2003.08386 (DLow).

    Examples
    --------
    One hypothesis is 3 and 1 from the truth at the two frames, the other 0 and 5.

    >>> import numpy as np
    >>> hypotheses = np.array([[3.0, 1.0], [0.0, 5.0]]).reshape(2, 2, 1, 1)
    >>> ade(hypotheses, np.zeros((2, 1, 1)), axes="NMKD")
    array([2.])
    """
    return of_clips(clip_errors, hypotheses, truth, clip, where, root, axes, unit)


def fde(
    hypotheses: npt.ArrayLike,
    truth: npt.ArrayLike,
    /,
    *,
    clip: npt.ArrayLike | None = None,
    where: npt.ArrayLike | None = None,
    root: int | None = None,
    axes: str | None = None,
    unit: str | float | None = None,
) -> FloatArray:
    r"""Final displacement error of each clip, of the hypothesis that is best at its last frame: FDE.

    .. math:: \min_n \lVert x_{nT} - y_T \rVert_2

    Parameters
    ----------
    hypotheses, truth, clip, where, root, axes, unit
        As for :func:`ade`.

    Returns
    -------
    array (C,)
        Errors, mm; lower is better, 0 at best; NaN as for :func:`ade`.

    Raises
    ------
    PoseDataError
        As :func:`ade`.

    Notes
    -----
    The hypothesis need not be the one that ADE takes. Differs from the published code: none.

    See Also
    --------
    ade : Over all frames.

    References
    ----------
    Yuan and Kitani, arXiv:2003.08386 (DLow).

    Examples
    --------
    >>> import numpy as np
    >>> hypotheses = np.array([[3.0, 1.0], [0.0, 5.0]]).reshape(2, 2, 1, 1)
    >>> fde(hypotheses, np.zeros((2, 1, 1)), axes="NMKD")
    array([1.])
    """
    return of_clips(final_errors, hypotheses, truth, clip, where, root, axes, unit)


def apd(
    hypotheses: npt.ArrayLike,
    truth: npt.ArrayLike,
    /,
    *,
    clip: npt.ArrayLike | None = None,
    where: npt.ArrayLike | None = None,
    root: int | None = None,
    axes: str | None = None,
    unit: str | float | None = None,
) -> FloatArray:
    r"""Average pairwise distance of the hypotheses of each clip: APD.

    .. math:: \frac{1}{N (N-1)} \sum_{i \ne j} \lVert x_i - x_j \rVert_2

    with the norm over all frames, joints and coordinates.

    Parameters
    ----------
    hypotheses, truth, clip, where, root, axes, unit
        As for :func:`ade`; of the truth only the shape matters.

    Returns
    -------
    array (C,)
        Distances, mm; neither higher nor lower is better; 0 for one hypothesis.

    Raises
    ------
    PoseDataError
        As :func:`ade`.

    Notes
    -----
    It grows with √T: those of clips of other lengths do not compare. Differs from the published code: none.

    See Also
    --------
    apde : Against the set of truths.

    References
    ----------
    Aliakbarian et al., CVPR 2020; Yuan and Kitani, arXiv:2003.08386 (DLow).

    Examples
    --------
    Two hypotheses are 3 apart at the first frame and 4 at the second.

    >>> import numpy as np
    >>> hypotheses = np.array([[3.0, 1.0], [0.0, 5.0]]).reshape(2, 2, 1, 1)
    >>> apd(hypotheses, np.zeros((2, 1, 1)), axes="NMKD")
    array([5.])
    """
    return of_clips(pair_distances, hypotheses, truth, clip, where, root, axes, unit)


def clip_energy_score(
    hypotheses: npt.ArrayLike,
    truth: npt.ArrayLike,
    /,
    *,
    clip: npt.ArrayLike | None = None,
    where: npt.ArrayLike | None = None,
    root: int | None = None,
    axes: str | None = None,
    unit: str | float | None = None,
) -> FloatArray:
    r"""Fair energy score of each clip as one vector of all its frames.

    .. math:: \frac{1}{N} \sum_n \lVert x_n - y \rVert - \frac{1}{2 N (N-1)} \sum_{i \ne j} \lVert x_i - x_j \rVert

    with the norm over all frames, joints and coordinates.

    Parameters
    ----------
    hypotheses, truth, clip, where, root, axes, unit
        As for :func:`ade`.

    Returns
    -------
    array (C,)
        Scores, mm; lower is better; single clips may be below 0.

    Raises
    ------
    PoseDataError
        As :func:`ade`, and for one hypothesis.

    Notes
    -----
    Proper for the law of whole motions: hypotheses that are right at each frame, and jump between frames, score worse
    than motions. The second term is half the :func:`apd`. Differs from the published code: not in it.

    See Also
    --------
    posecal.metrics.energy_score : Of each pose.

    References
    ----------
    Gneiting and Raftery (2007), doi:10.1198/016214506000001437; Ferro (2014), doi:10.1002/qj.2270.

    Examples
    --------
    Distances of √10 and 5 from the truth, less half of 5.

    >>> import numpy as np
    >>> hypotheses = np.array([[3.0, 1.0], [0.0, 5.0]]).reshape(2, 2, 1, 1)
    >>> clip_energy_score(hypotheses, np.zeros((2, 1, 1)), axes="NMKD").round(4)
    array([1.5811])
    """
    if len(checked(hypotheses, truth, axes=axes, unit=unit)[0]) < 2:
        raise PoseDataError("hypotheses: N = 1; fair scores need at least 2.")
    return of_clips(clip_energies, hypotheses, truth, clip, where, root, axes, unit)


# --- metrics ----------------------------------------------------------------------------------------------------------

CLIP = partial(
    Metric, unit="mm", direction="lower", family="accuracy", needs=("positions",), range="0 at best", bounds=POSITIVE
)
DLOW = "Yuan and Kitani, arXiv:2003.08386 (DLow)"


def displacement_metrics(scope: Scope) -> Iterator[Metric]:
    """ADE, FDE, APD and the energy score of clips."""
    T, N = scope.spec.clip_length, scope.spec.n_hypotheses
    norm = f"norm over {scope.counted(scope.body)} and all coordinates"
    of_clip = norm.replace("over", f"over {T} frames,")
    best = f"best of N={N} per clip of T={T}"
    yield CLIP(
        name="ade",
        label="ADE",
        brief=f"{best}, whole pose",
        definition=f"mean over clips of the smallest of the N={N} means over its T={T} frames of ‖x − y‖, {norm}; of "
        "some frames: of the hypothesis that is best over the clip",
        statistic=clip_statistic(scope, "clip_errors", clip_errors),
        finish=entry(),
        headline=True,
        in_group_table=True,
        reading="The field's average displacement error. Falls with N, and rewards a spread that is too wide.",
        source=DLOW,
    )
    yield CLIP(
        name="fde",
        label="FDE",
        brief=f"{best}, at its last frame",
        definition=f"mean over clips of the smallest of the N={N} ‖x − y‖ at frame T={T}, {norm}",
        statistic=clip_statistic(scope, "final_errors", final_errors),
        finish=entry(),
        headline=True,
        in_group_table=True,
        reading="The hypothesis need not be that of ADE. Falls with N, and rewards a spread that is too wide.",
        source=DLOW,
    )
    if N < 2:
        return
    yield CLIP(
        name="apd",
        label="APD",
        direction="none",
        family="sharpness",
        brief="mean distance of two hypotheses of a clip",
        definition=f"mean over clips of the mean over pairs of the N={N} hypotheses of ‖x − x′‖, {of_clip}",
        statistic=clip_statistic(scope, "pair_distances", pair_distances),
        finish=entry(),
        headline=True,
        range="0 (all hypotheses are one) upwards",
        reading="Papers call more diversity better. It never looks at the truth: a wrong spread has more, too.",
        source=f"Aliakbarian et al., CVPR 2020; {DLOW}",
    )
    yield SCORE(
        name="clip_energy_score",
        label="energy score of clips",
        needs=("positions",),
        brief=f"fair, whole clip of T={T}",
        definition=f"mean over clips of mean ‖x − y‖ − ½ mean ‖x − x′‖, {of_clip}; fair in N={N}",
        statistic=clip_statistic(scope, "clip_energies", clip_energies),
        finish=entry(),
    )
