"""How far are the steps of the hypotheses from the true steps? The velocity error (MPJVE)."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from posecal.data.arrays import BoolArray, FloatArray, checked, squared_norms
from posecal.engine.block import Block
from posecal.engine.blocks import per_pose
from posecal.errors import PoseDataError
from posecal.metrics.position import OfPoses

__all__ = ["mpjve", "velocity_errors"]


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
    found: FloatArray = np.einsum("bk,bkn->bn", weights, errors)
    found[~weights.any(axis=1)] = np.nan
    return found


def mpjve(
    hypotheses: npt.ArrayLike,
    truth: npt.ArrayLike,
    /,
    *,
    sequence: npt.ArrayLike | None = None,
    fps: float | None = None,
    where: npt.ArrayLike | None = None,
    root: int | None = None,
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
    where : bool array (M, K), optional
        The joints that count; a step needs the joint in both of its poses.
    root : int, optional
        The joint to subtract from every pose first.

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
    _, y, _ = checked(hypotheses, truth, where)
    labels = np.zeros(len(y)) if sequence is None else np.asarray(sequence)
    if labels.shape != (len(y),):
        raise PoseDataError(f"sequence {labels.shape}: expected (M,) = ({len(y)},).")
    if fps is not None and not 0 < fps < float("inf"):
        raise PoseDataError(f"fps: {fps}; expected frames per second above 0.")
    follows = np.concatenate([[False], labels[1:] == labels[:-1]])

    def statistic(block: Block) -> FloatArray:
        return np.asarray(velocity_errors(block).mean(axis=-1, dtype=np.float64))

    per_frame = per_pose(statistic, hypotheses, truth, where, root=root, follows=follows)
    return per_frame if fps is None else per_frame * fps
