"""Motion: steps, acceleration and jerk of the hypotheses from frame to frame (MPJVE, acceleration error, jitter)."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import Any, Literal, get_args

import numpy as np
import numpy.typing as npt

from posecal.data.arguments import checked
from posecal.data.arrays import BoolArray, FloatArray, as_array, checked_choice, checked_number, squared_norms
from posecal.engine.block import Block
from posecal.engine.bounds import POSITIVE
from posecal.engine.metric import Metric, Statistic
from posecal.engine.per_pose import per_pose
from posecal.engine.scope import Scope
from posecal.errors import PoseDataError

Mover = Literal["hypotheses", "truth"]
"""What a jitter is of."""

Moving = Literal["error", "mean_pose_error", "hypotheses", "mean_pose", "truth"]
"""What differences over time are of: the offsets from the truth, or positions."""

_ATTRIBUTES: dict[Moving, str] = {
    "error": "offsets",
    "mean_pose_error": "mean_offsets",
    "hypotheses": "poses",
    "mean_pose": "mean_poses",
    "truth": "truth",
}
"""What these are of a block."""


def motion(block: Block, order: int, of: Moving = "error", body: BoolArray | None = None) -> FloatArray:
    """Mean over joints of the norm of differences over time, and over hypotheses.

    Parameters
    ----------
    block : Block
        B poses.
    order : int
        1 for steps between frames, 2 for accelerations, 3 for jerks.
    of : str
        ``error``: hypotheses minus truth; or the positions of the ``hypotheses`` or of the ``truth``. ``mean_pose`` and
        ``mean_pose_error`` are of the mean of the hypotheses.
    body : bool array (K,), optional
        The joints that the mean is over; all by default.

    Returns
    -------
    array (B,)
        ‖Δx − Δy‖ or ‖Δx‖ of that order, mm per frame to the power of it. NaN for the first poses of a sequence, and
        where no joint counts in all poses of the difference.
    """
    changes, counted = block.differences(order, _ATTRIBUTES[of])
    changes = changes.reshape(*changes.shape[:3], -1)
    weights = block.joint_weights(counted if body is None else counted & body)
    means = np.einsum("bk,bkn->bn", weights, np.sqrt(squared_norms(changes))).mean(axis=-1, dtype=np.float64)
    return np.where(weights.any(axis=1), means, np.nan)


def mpjve(
    hypotheses: npt.ArrayLike,
    truth: npt.ArrayLike,
    /,
    *,
    sequence: npt.ArrayLike | None = None,
    fps: float | None = None,
    where: npt.ArrayLike | None = None,
    root: int | None = None,
    axes: str | None = None,
    unit: str | float | None = None,
) -> FloatArray:
    r"""Mean per-joint velocity error of each pose, from the pose before it in its sequence.

    .. math:: \frac{1}{N K} \sum_{n, k} \lVert (x_{nmk} - x_{n,m-1,k}) - (y_{mk} - y_{m-1,k}) \rVert_2

    Parameters
    ----------
    hypotheses : array (N, M, K, D)
        Hypotheses, mm; hypothesis n is followed through the sequence.
    truth : array (M, K, D)
        True poses, mm, in the order of time.
    sequence : array (M,), optional
        The sequence of each pose; all are one sequence by default.
    fps : float, optional
        Frames per second; with it the result is per second, else per frame.
    where : bool array (M, K) or (M,), optional
        The joints that count; a step needs the joint in both of its poses.
    root : int, optional
        The joint to subtract from every pose first.
    axes, unit : str, optional
        Such as ``MNKD`` and ``m``, where the hypotheses are not (N, M, K, D), or both not in mm, or it is not clear.
        Angles, ``deg`` or ``rad``, are measured the shorter way round, in degrees.

    Returns
    -------
    array (M,)
        Errors, mm per frame or per second; lower is better; NaN for the first pose of each sequence, and for a pose
        that shares no joint that counts with the pose before it.

    Raises
    ------
    PoseDataError
        For shapes, dtypes or values that don't fit.

    Notes
    -----
    Differs from the published code: VideoPose3D takes one pose per frame and all frames as one sequence.

    See Also
    --------
    posecal.metrics.mpjpe : Error of the positions.
    acceleration_error : Error of the accelerations.

    References
    ----------
    Pavllo et al., arXiv:1811.11742.

    Examples
    --------
    The truth stands still and the hypothesis walks 5 mm a frame.

    >>> import numpy as np
    >>> walk = np.array([0.0, 5.0, 10.0]).reshape(1, 3, 1, 1) * [1.0, 0.0, 0.0]
    >>> mpjve(walk, np.zeros((3, 1, 3)))
    array([nan,  5.,  5.])
    """
    return _over_time(1, "error", hypotheses, truth, sequence, fps, where, root=root, axes=axes, unit=unit)


def acceleration_error(
    hypotheses: npt.ArrayLike,
    truth: npt.ArrayLike,
    /,
    *,
    sequence: npt.ArrayLike | None = None,
    fps: float | None = None,
    where: npt.ArrayLike | None = None,
    root: int | None = None,
    axes: str | None = None,
    unit: str | float | None = None,
) -> FloatArray:
    r"""Mean per-joint error of the acceleration of each pose, from the two poses before it in its sequence.

    .. math:: \frac{1}{N K} \sum_{n, k} \lVert \ddot x_{nmk} - \ddot y_{mk} \rVert_2, \qquad
        \ddot y_m = y_m - 2 y_{m-1} + y_{m-2}

    Parameters
    ----------
    hypotheses, truth, sequence, where, root, axes, unit
        As for :func:`mpjve`; a difference needs the joint in all three poses.
    fps : float, optional
        Frames per second; with it the result is per second², else per frame².

    Returns
    -------
    array (M,)
        Errors, mm per frame² or per second²; lower is better, 0 at best; NaN for the first two poses of each sequence,
        and for a pose that shares no joint that counts with the two before it.

    Raises
    ------
    PoseDataError
        For shapes, dtypes or values that don't fit.

    Notes
    -----
    Differs from the published code: it takes one hypothesis, leaves out frames only where all joints are invalid, and
    names the middle of the three frames, which changes no mean. VIBE's number is per frame², whatever its unit says.

    See Also
    --------
    mpjve : Error of the steps.
    jitter : Roughness of the hypotheses' own motion.

    References
    ----------
    Kanazawa et al., arXiv:1812.01601; Shin et al., arXiv:2312.07531 (WHAM).

    Examples
    --------
    The truth stands still and the hypothesis starts to walk 5 mm a frame.

    >>> import numpy as np
    >>> walk = np.array([0.0, 0.0, 5.0, 10.0]).reshape(1, 4, 1, 1) * [1.0, 0.0, 0.0]
    >>> acceleration_error(walk, np.zeros((4, 1, 3)))
    array([nan, nan,  5.,  0.])
    """
    return _over_time(2, "error", hypotheses, truth, sequence, fps, where, root=root, axes=axes, unit=unit)


def jitter(
    hypotheses: npt.ArrayLike,
    truth: npt.ArrayLike,
    /,
    *,
    of: Mover = "hypotheses",
    sequence: npt.ArrayLike | None = None,
    fps: float | None = None,
    where: npt.ArrayLike | None = None,
    root: int | None = None,
    axes: str | None = None,
    unit: str | float | None = None,
) -> FloatArray:
    r"""Mean norm of the jerk of each pose's joints, from the three poses before it in its sequence.

    .. math:: \frac{1}{N K} \sum_{n, k} \lVert x_{nmk} - 3 x_{n,m-1,k} + 3 x_{n,m-2,k} - x_{n,m-3,k} \rVert_2

    Parameters
    ----------
    hypotheses, truth, sequence, where, root, axes, unit
        As for :func:`mpjve`; a difference needs the joint in all four poses.
    of : str
        ``hypotheses``, or ``truth``: what a jitter is to be compared with.
    fps : float, optional
        Frames per second; with it the result is per second³, else per frame³.

    Returns
    -------
    array (M,)
        Jitter, mm per frame³ or per second³ (10,000 mm/s³ are the 10 m/s³ of papers); neither is better, the truth's is
        best; NaN for the first three poses of each sequence, and for a pose that shares no joint that counts with the
        three before it.

    Raises
    ------
    PoseDataError
        For shapes, dtypes or values that don't fit.

    Notes
    -----
    Differs from the published code: it takes one hypothesis, in the frame of the world, as here without ``root``.

    See Also
    --------
    acceleration_error : Error of the accelerations.

    References
    ----------
    Flash and Hogan, J. Neurosci. 5, 1688 (1985); Yi et al., arXiv:2105.04605 (TransPose).

    Examples
    --------
    The hypothesis jumps by 2 mm and stays there.

    >>> import numpy as np
    >>> jump = np.array([0.0, 0.0, 0.0, 2.0, 2.0, 2.0, 2.0]).reshape(1, 7, 1, 1) * [1.0, 0.0, 0.0]
    >>> jitter(jump, np.zeros((7, 1, 3)))
    array([nan, nan, nan,  2.,  4.,  2.,  0.])
    """
    checked_choice(of, "of", get_args(Mover))
    return _over_time(3, of, hypotheses, truth, sequence, fps, where, root=root, axes=axes, unit=unit)


def _over_time(
    order: int,
    of: Moving,
    hypotheses: npt.ArrayLike,
    truth: npt.ArrayLike,
    sequence: npt.ArrayLike | None,
    fps: float | None,
    where: npt.ArrayLike | None,
    **options: Any,
) -> FloatArray:
    """Compute :func:`motion` of every pose, per frame or per second."""
    _, y, _ = checked(hypotheses, truth, where, axes=options["axes"], unit=options["unit"])
    labels = np.zeros(len(y)) if sequence is None else as_array(sequence, "sequence")
    if labels.shape != (len(y),):
        raise PoseDataError(f"sequence {labels.shape}: expected (M,) = ({len(y)},).")
    rate = 1.0 if fps is None else checked_number(fps, "fps", lambda fps: 0 < fps < np.inf, "frames per second above 0")
    follows = np.concatenate([[False], labels[1:] == labels[:-1]])
    statistic = partial(motion, order=order, of=of)
    return per_pose(statistic, hypotheses, truth, where, follows=follows, earlier=order, **options) * rate**order


# --- metrics --------------------------------------------------------------------------------------------------

_ORDERS = {
    1: (
        *("steps", "", "‖Δx − Δy‖", "Pavllo et al., arXiv:1811.11742"),
        "How much the hypotheses jitter against the true motion. Those drawn anew for every frame jitter by design.",
    ),
    2: (
        *("accelerations", "²", "‖Δ²x − Δ²y‖, Δ²x = x[t] − 2 x[t−1] + x[t−2]"),
        "Kanazawa et al., arXiv:1812.01601; Shin et al., arXiv:2312.07531 (WHAM)",
        "The field's ACCEL. Hypotheses drawn anew for every frame have a large one by design.",
    ),
    3: (
        *("jerks", "³", "‖Δ³x‖, Δ³x = x[t] − 3 x[t−1] + 3 x[t−2] − x[t−3]"),
        "Yi et al., arXiv:2105.04605 (TransPose); Shin et al., arXiv:2312.07531 (WHAM)",
        "Read it beside the jitter of the truth: a motion above it shakes, one below it is too smooth. Papers give it "
        "per second, in 10 m/s³, of positions in the world.",
    ),
}
"""Of each order: what it is of, its power in the unit, formula, source, and how to read it."""


def velocity_metrics(scope: Scope) -> Iterator[Metric]:
    """MPJVE, acceleration error and jitter of the hypotheses and of their mean, where poses have sequences."""
    second, fps = scope.protocol.velocity == "second", scope.spec.fps
    if "sequence" not in scope.spec.labels:
        return
    if second and fps is None:
        raise PoseDataError("velocity: second needs the frames per second. Store fps in the truth's file.")
    factor = fps if second and fps is not None else 1.0
    each, one = "mean over hypotheses, each followed through its sequence, of the ", "mean of the hypotheses, the "
    kinds: tuple[tuple[str, str, int, Moving, str], ...] = (
        ("mpjve", "MPJVE", 1, "error", each),
        ("mean_pose_mpjve", "mean-pose MPJVE", 1, "mean_pose_error", one),
        ("acceleration_error", "acceleration error", 2, "error", each),
        ("mean_pose_acceleration_error", "mean-pose acceleration error", 2, "mean_pose_error", one),
        ("jitter", "jitter", 3, "hypotheses", each),
        ("mean_pose_jitter", "mean-pose jitter", 3, "mean_pose", one),
        ("true_jitter", "jitter of the truth", 3, "truth", ""),
    )
    for name, label, order, of, words in kinds:
        noun, power, formula, source, reading = _ORDERS[order]
        yield Metric(
            name=name,
            label=label,
            unit=f"mm/{'s' if second else 'frame'}{power}",
            direction="none" if order == 3 else "lower",
            family="accuracy",
            brief=f"of {noun} between frames",
            definition=f"mean over consecutive poses of a sequence of the {words}mean over "
            f"{scope.counted(scope.body)} of {formula.replace('x', 'y') if of == 'truth' else formula}",
            statistic=Statistic(name, partial(motion, order=order, of=of, body=scope.body), earlier=order),
            finish=partial(np.multiply, factor**order),
            range="0 mm upwards",
            bounds=POSITIVE,
            reading=reading,
            source=source,
        )
