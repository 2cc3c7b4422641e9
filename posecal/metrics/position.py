"""How far are the hypotheses from the truth? The MPJPE family.

The error of a hypothesis is the mean over a pose's joints of the distance to the truth, in the units of the
arrays (posecal uses millimetres). From N hypotheses to one number per pose there are several ways in use, and
they differ by tens of millimetres on the same array, so each has a name of its own:

- of the N errors: the smallest (``min``, the field's minMPJPE), their ``mean``, ``median`` or the largest
  (``worst``);
- the error of one pose made of the hypotheses: their mean (``mean_pose``), their per-coordinate median
  (``median_pose``), their mean weighted by the model's scores (``weighted_pose``), or one of them, declared by its
  index or by the highest score (``mode``).

Functions of arrays take positions as they stand; ``root`` subtracts one joint first. The root then counts with
its error of 0 unless ``where`` leaves it out.
"""

from __future__ import annotations

from typing import Literal, get_args

import numpy as np
import numpy.typing as npt

from posecal.data.arrays import BoolArray, FloatArray
from posecal.engine.block import Block
from posecal.engine.blocks import per_pose
from posecal.errors import PoseDataError, did_you_mean
from posecal.geometry.procrustes import Alignment, aligned_errors
from posecal.metrics.best_of import OF_ERRORS, OfErrors, best_of, subset_weights

__all__ = [
    "OF_POSES",
    "OfPoses",
    "joint_errors",
    "linked",
    "min_mpjpe",
    "min_mpjpe_curve",
    "mpjpe",
    "pose_errors",
    "pose_of",
]

OfPoses = Literal["mean_pose", "median_pose", "weighted_pose", "mode"]
OF_POSES: tuple[OfPoses, ...] = get_args(OfPoses)


def pose_of(block: Block, of: OfPoses, mode: int | None = None) -> FloatArray:
    """Make one pose of the N hypotheses.

    Parameters
    ----------
    block : Block
        B poses.
    of : str
        One of :data:`OF_POSES`.
    mode : int, optional
        For ``mode``, the index of the hypothesis; without it the one of the highest score.

    Returns
    -------
    array (B, K, D, 1)
        Its offset from the truth, mm.

    Raises
    ------
    PoseDataError
        For scores that are not finite, or can't be weights where weights are needed.
    """
    x = block.offsets
    if of == "mean_pose":
        mean: FloatArray = x.mean(axis=-1, keepdims=True)
        return mean
    if of == "median_pose":
        return block.median[..., None]
    if of == "weighted_pose":
        total = block.scores.sum(axis=-1, keepdims=True)
        if (block.scores < 0).any() or not total.all():
            raise PoseDataError(
                "hypotheses: scores below 0, or all 0 for a pose; expected weights to take a mean of the hypotheses "
                "with. Store probabilities, or leave the weighted_pose metrics out."
            )
        shares = (block.scores / total).astype(x.dtype)
        weighted: FloatArray = np.einsum("bkdn,bn->bkd", x, shares)
        return weighted[..., None]
    chosen = block.scores.argmax(axis=-1) if mode is None else np.full(x.shape[0], mode)
    return np.take_along_axis(x, chosen[:, None, None, None], axis=-1)


def joint_errors(
    block: Block,
    align: Alignment = "none",
    of: OfPoses | None = None,
    fit: BoolArray | None = None,
    mode: int | None = None,
) -> FloatArray:
    """Distance from the truth per joint, after an alignment, of each hypothesis or of one pose made of them.

    Parameters
    ----------
    block : Block
        B poses.
    align : str
        How each pose is moved onto the truth first; see :mod:`posecal.geometry.procrustes`.
    of : str, optional
        One of :data:`OF_POSES`; each hypothesis by default.
    fit : bool array (K,), optional
        The joints to which the alignment is fitted, of those that are usable; all by default.
    mode : int, optional
        As for :func:`pose_of`.

    Returns
    -------
    array (B, K, n)
        Errors, mm; n is N, or 1 for one pose.
    """
    if align == "none" and of is None:
        return block.errors
    key = ("joint_errors", align, of, None if fit is None or align == "none" else fit.tobytes(), mode)

    def compute() -> FloatArray:
        whole = block if align == "none" else block.whole
        offsets = whole.offsets if of is None else pose_of(whole, of, mode)
        return aligned_errors(offsets, whole.truth, whole.weights(fit), align)

    return block.share(key, compute)


def pose_errors(
    block: Block,
    align: Alignment = "none",
    of: OfPoses | None = None,
    body: BoolArray | None = None,
    mode: int | None = None,
    fit: BoolArray | None = None,
) -> FloatArray:
    """Mean over a pose's joints of :func:`joint_errors`.

    Parameters
    ----------
    block, align, of, mode
        As for :func:`joint_errors`.
    body : bool array (K,), optional
        The joints that the mean is over; all by default.
    fit : bool array (K,), optional
        The joints to which the alignment is fitted; those of ``body`` by default.

    Returns
    -------
    array (B, n)
        Errors, mm; NaN for poses without a joint that counts.
    """
    fit = body if fit is None else fit

    def compute() -> FloatArray:
        weights = block.weights(body)
        errors = (weights[:, None] @ joint_errors(block, align, of, fit, mode))[:, 0]
        errors[~weights.any(axis=1)] = np.nan
        return errors

    masks = (None if mask is None else mask.tobytes() for mask in (body, None if align == "none" else fit))
    return block.share(("pose_errors", align, of, *masks, mode), compute)


def linked(block: Block, values: FloatArray, body: BoolArray | None = None) -> FloatArray:
    """Take from values (B, ..., N) those of the hypothesis that minMPJPE chooses, (B, ...)."""
    errors = pose_errors(block, body=body)
    chosen = np.where(np.isnan(errors), np.inf, errors).argmin(axis=-1)
    places = chosen.reshape(-1, *[1] * (values.ndim - 1))
    taken: FloatArray = np.take_along_axis(values, places, axis=-1).squeeze(axis=-1)
    return taken


def mpjpe(
    hypotheses: npt.ArrayLike,
    truth: npt.ArrayLike,
    /,
    *,
    of: OfErrors | OfPoses = "mean",
    align: Alignment = "none",
    where: npt.ArrayLike | None = None,
    root: int | None = None,
    mode: int = 0,
) -> FloatArray:
    r"""Mean per-joint position error of each pose.

    .. math:: e_{nm} = \frac{1}{K} \sum_k \lVert x_{nmk} - y_{mk} \rVert_2

    and of the N errors of a pose their mean, or what ``of`` names.

    Parameters
    ----------
    hypotheses : array (N, M, K, D)
        Hypotheses, mm.
    truth : array (M, K, D)
        True poses, mm.
    of : str
        ``mean``, ``min``, ``median`` or ``worst`` of the N errors; or the error of one pose made of the
        hypotheses: ``mean_pose``, ``median_pose`` or ``mode`` (the hypothesis of index ``mode``).
    align : str
        ``none``, ``similarity`` (PA-MPJPE), ``rigid``, ``reflection``, ``scale`` (N-MPJPE), ``norm_root`` or
        ``rms_mean``; see :mod:`posecal.geometry.procrustes`.
    where : bool array (M, K), optional
        The joints that count: those that the mean is over and, too, those that the alignment is fitted to.
    root : int, optional
        The joint to subtract from every pose first.
    mode : int
        The index that ``of="mode"`` takes.

    Returns
    -------
    array (M,)
        Errors, mm; lower is better, 0 at best; NaN for a pose without a joint that counts.

    Raises
    ------
    PoseDataError
        For shapes, dtypes, values or names that don't fit.

    Notes
    -----
    ``of="median"`` of an even N lies between the two middle errors; ProHPE's script takes the lower.
    Differs from the published code: none for the default.

    References
    ----------
    Wang et al., arXiv:2104.11536 (MPJPE and its protocols).

    Examples
    --------
    Two hypotheses of one pose with two joints; the first is a 3-4-5 triangle off at one joint.

    >>> import numpy as np
    >>> truth = np.zeros((1, 2, 3))
    >>> hypotheses = np.zeros((2, 1, 2, 3))
    >>> hypotheses[0, 0, 0] = 3, 4, 0
    >>> mpjpe(hypotheses, truth)
    array([1.25])
    >>> mpjpe(hypotheses, truth, of="worst")
    array([2.5])
    """
    if of in OF_ERRORS:
        return per_pose(lambda b: best_of(pose_errors(b, align), of), hypotheses, truth, where, root=root)
    if of not in OF_POSES or of == "weighted_pose":
        known = [*OF_ERRORS, *(name for name in OF_POSES if name != "weighted_pose")]
        raise PoseDataError(f"of: {of!r} is not known. {did_you_mean(of, known)}")
    n_hypotheses = np.shape(hypotheses)[0] if np.ndim(hypotheses) else 0
    if of == "mode" and not 0 <= mode < n_hypotheses:
        raise PoseDataError(f"mode: {mode}; expected the index of one of {n_hypotheses} hypotheses.")
    return per_pose(lambda b: pose_errors(b, align, of, mode=mode)[:, 0], hypotheses, truth, where, root=root)


def min_mpjpe(
    hypotheses: npt.ArrayLike,
    truth: npt.ArrayLike,
    /,
    *,
    align: Alignment = "none",
    where: npt.ArrayLike | None = None,
    root: int | None = None,
) -> FloatArray:
    r"""Error of the best of the N hypotheses of each pose: minMPJPE.

    .. math:: \min_n \frac{1}{K} \sum_k \lVert x_{nmk} - y_{mk} \rVert_2

    Parameters
    ----------
    hypotheses, truth, align, where, root
        As for :func:`mpjpe`.

    Returns
    -------
    array (M,)
        Errors, mm; lower is better, 0 at best; NaN for a pose without a joint that counts.

    Raises
    ------
    PoseDataError
        For shapes, dtypes, values or names that don't fit.

    Notes
    -----
    It falls with N whatever the model (see :func:`posecal.metrics.position.min_mpjpe_curve`), and the distribution that
    minimises it is not the true one. Differs from the published code: none.

    References
    ----------
    Jahangiri and Yuille, arXiv:1702.02258; Pierzchlewicz et al., arXiv:2210.11179.

    Examples
    --------
    >>> import numpy as np
    >>> hypotheses = np.zeros((2, 1, 1, 3))
    >>> hypotheses[:, 0, 0] = [[3, 4, 0], [0, 0, 2]]
    >>> min_mpjpe(hypotheses, np.zeros((1, 1, 3)))
    array([2.])
    """
    return mpjpe(hypotheses, truth, of="min", align=align, where=where, root=root)


def subset_errors(
    block: Block, sizes: npt.NDArray[np.intp], align: Alignment = "none", body: BoolArray | None = None
) -> FloatArray:
    """Expected error of the best of a random subset of the hypotheses, (B, T), mm, for T subset sizes."""
    ordered = np.sort(pose_errors(block, align, body=body), axis=-1)
    return np.asarray(ordered @ subset_weights(block.n_hypotheses, sizes).T)


def min_mpjpe_curve(
    hypotheses: npt.ArrayLike,
    truth: npt.ArrayLike,
    /,
    sizes: npt.ArrayLike,
    *,
    align: Alignment = "none",
    where: npt.ArrayLike | None = None,
    root: int | None = None,
) -> FloatArray:
    r"""Expected minMPJPE of each pose with n of the N hypotheses, exactly, without sampling anew.

    .. math:: \sum_{i=1}^{N} e_{(i)} \binom{N - i}{n - 1} \Big/ \binom{N}{n}

    over the N errors of a pose in ascending order: the mean over all subsets of n hypotheses.

    Parameters
    ----------
    hypotheses, truth, align, where, root
        As for :func:`mpjpe`.
    sizes : array of int (T,)
        The n, each from 1 to N. At 1 it is the mean error, at N it is minMPJPE.

    Returns
    -------
    array (M, T)
        Errors, mm; lower is better; each row falls.

    Raises
    ------
    PoseDataError
        For shapes, dtypes, values, names or sizes that don't fit.

    Notes
    -----
    Differs from the published code: none; papers rerun with fewer samples.

    Examples
    --------
    Errors of 1, 2 and 6 mm: the best of two is 1 in two of three pairs and 2 in the third.

    >>> import numpy as np
    >>> hypotheses = np.array([1.0, 2.0, 6.0]).reshape(3, 1, 1, 1)
    >>> min_mpjpe_curve(hypotheses, np.zeros((1, 1, 1)), [1, 2, 3]).round(4)
    array([[3.    , 1.3333, 1.    ]])
    """
    asked = np.asarray(sizes)
    n_hypotheses = np.shape(hypotheses)[0] if np.ndim(hypotheses) else 0
    if asked.ndim != 1 or asked.dtype.kind not in "iu" or not ((asked >= 1) & (asked <= n_hypotheses)).all():
        raise PoseDataError(f"sizes: {asked.tolist()}; expected whole numbers from 1 to N = {n_hypotheses}.")
    return per_pose(lambda b: subset_errors(b, asked, align), hypotheses, truth, where, root=root)
