"""Velocity error: distances of the steps of the hypotheses between frames from the true steps (MPJVE)."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import numpy as np
import numpy.typing as npt

from posecal.data.arguments import checked
from posecal.data.arrays import BoolArray, FloatArray, as_array, checked_number, squared_norms
from posecal.engine.block import Block
from posecal.engine.metric import Metric, Statistic
from posecal.engine.per_pose import per_pose
from posecal.engine.scope import Scope
from posecal.errors import PoseDataError
from posecal.metrics.position import OfPoses


def velocity_errors(block: Block, *, of: OfPoses | None = None, body: BoolArray | None = None) -> FloatArray:
    """Mean over joints of how much the step since the pose before differs from the true step.

    Returns
    -------
    array (B, n)
        ‖Δx - Δy‖, mm per frame; n is N, or 1 for ``of="mean_pose"``. NaN for the first pose of a sequence, and where
        no joint counts in both poses.
    """
    steps = block.velocity_offsets
    if of == "mean_pose":
        steps = steps.mean(axis=-1, keepdims=True)
    errors = np.sqrt(squared_norms(steps))
    weights = block.weights(block.where_before if body is None else block.where_before & body)
    means: FloatArray = np.einsum("bk,bkn->bn", weights, errors)
    means[~weights.any(axis=1)] = np.nan
    return means


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
    _, y, _ = checked(hypotheses, truth, where, axes=axes, unit=unit)
    labels = np.zeros(len(y)) if sequence is None else as_array(sequence, "sequence")
    if labels.shape != (len(y),):
        raise PoseDataError(f"sequence {labels.shape}: expected (M,) = ({len(y)},).")
    rate = 1.0 if fps is None else checked_number(fps, "fps", lambda fps: 0 < fps < np.inf, "frames per second above 0")
    follows = np.concatenate([[False], labels[1:] == labels[:-1]])

    def statistic(block: Block) -> FloatArray:
        return np.asarray(velocity_errors(block).mean(axis=-1, dtype=np.float64))

    return per_pose(statistic, hypotheses, truth, where, root=root, follows=follows, axes=axes, unit=unit) * rate


# --- metrics --------------------------------------------------------------------------------------------------


def velocity_metrics(scope: Scope) -> Iterator[Metric]:
    """MPJVE of the hypotheses and of their mean, where poses have sequences."""
    second, fps = scope.protocol.velocity == "second", scope.spec.fps
    if "sequence" not in scope.spec.labels:
        return
    if second and fps is None:
        raise PoseDataError("velocity: second needs the frames per second. Store fps in the truth's file.")
    factor = fps if second and fps is not None else 1.0

    def errors(block: Block, of: OfPoses | None) -> FloatArray:
        return np.asarray(velocity_errors(block, of=of, body=scope.body).mean(axis=-1))

    kinds: tuple[tuple[str, str, OfPoses | None, str], ...] = (
        ("mpjve", "MPJVE", None, "the mean over hypotheses, each followed through its sequence, of the"),
        ("mean_pose_mpjve", "MPJVE, mean pose", "mean_pose", "the mean of the hypotheses, the"),
    )
    for name, label, of, words in kinds:
        yield Metric(
            name=name,
            label=label,
            unit="mm/s" if second else "mm/frame",
            direction="lower",
            family="accuracy",
            brief="of steps between frames",
            definition=f"mean over consecutive poses of a sequence of {words} mean over {scope.counted(scope.body)} of "
            "‖Δx − Δy‖",
            statistic=Statistic(name, partial(errors, of=of)),
            finish=lambda means: means * factor,
            range="0 mm upwards",
            reading="How much the hypotheses jitter against the true motion. Those drawn anew for every frame jitter "
            "by design.",
            source="Pavllo et al., arXiv:1811.11742",
        )
