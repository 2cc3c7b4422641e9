"""Log densities that a model gives to the true poses, in nats, as densities in the unit that poses are measured in."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from posecal.data.arrays import BoolArray, FloatArray, checked_number, real_array
from posecal.data.remarks import Count, Remark
from posecal.data.root import AnyRoot, resting_joints
from posecal.data.stored_poses import Rows, StoredPoses
from posecal.errors import PosecalError, PoseDataError, attempt, first_few

MEMBERS = ("log_prob", "dimensions")
"""What a file of hypotheses may hold of them."""


def as_log_prob(values: object, name: str) -> FloatArray:
    """Convert the log density of every true pose into double precision.

    Raises
    ------
    PoseDataError
        Where it is not one real number per pose.
    """
    array = real_array(values, name)
    if array.ndim != 1:
        raise PoseDataError(f"{name}: {array.shape}; expected one log density per pose, (M,).")
    return array.astype(np.float64)


def as_dimensions(values: object, name: str) -> int:
    """Convert the number of coordinates that a density is over.

    Raises
    ------
    PoseDataError
        Where it is no whole number above 0.
    """
    expected = "the number of coordinates that the density is over, such as 48"
    return int(checked_number(np.squeeze(real_array(values, name)), name, lambda d: d >= 1 and d % 1 == 0, expected))


def number_of_coordinates(n_joints: int, n_coordinates: int, root: AnyRoot) -> int:
    """Give the number of coordinates of the joints that are not the root.

    Examples
    --------
    >>> number_of_coordinates(17, 3, root=0), number_of_coordinates(17, 3, root=None)
    (48, 51)
    """
    return n_coordinates * (n_joints - len(resting_joints(root)))


def poses_that_lack(counts: BoolArray | None, m: int) -> tuple[BoolArray, list[str]]:
    """Find the poses, (m,), of which a joint does not count, (m, k): they have no density. Say how many."""
    lacking: BoolArray = np.asarray(np.zeros(m, dtype=bool) if counts is None else ~counts.all(axis=1))
    lack = Count(int(lacking.sum()), "pose lacks", "poses lack")
    return lacking, [Remark("NLL: ", lack, " a joint; left out of it.")] if lacking.any() else []


def log_density(
    poses: StoredPoses,
    shape: tuple[int, ...],
    counts: BoolArray | None,
    rows: Rows,
    columns: Rows,
    frames: list[str],
    root: AnyRoot,
    factor: float,
    problems: list[str | PosecalError],
) -> tuple[FloatArray | None, int, list[str]]:
    r"""Give the log density of some poses in the unit that is measured in.

    .. math:: \log p_{mm} = \log p_{unit} - d \log(\text{mm in one unit})

    Parameters
    ----------
    poses : StoredPoses
        Hypotheses with what is declared about them.
    shape : tuple of int
        (N, M, K, D) of what is stored.
    counts : bool array (m, k) or None
        The joints that count; all by default.
    rows, columns : arrays of int (m,) and (k,)
        The stored poses and joints that are evaluated.
    frames : list of str
        Their names, for messages.
    root : int, Root or None
        What positions are relative to.
    factor : float
        Millimetres (or degrees) in one unit.
    problems : list
        What does not fit is added to it.

    Returns
    -------
    log_prob : array (m,) or None
        Nats; NaN for poses of which a joint does not count.
    dimensions : int
        d, the number of coordinates that the density is over; 0 without a density.
    remarks : list of str
        What a careful reader should know.
    """
    values, declared = poses.log_prob, poses.dimensions
    if values is None:
        if declared is not None:
            problems.append(f"{poses.name}: dimensions = {declared} without log_prob; expected both, or neither.")
        return None, 0, []
    _, m, k, d = shape
    if values.shape != (m,):
        problems.append(f"{poses.name}: log_prob {values.shape}; expected (M,) = ({m},).")
        return None, 0, []
    if declared is None and len(columns) < k:
        what = f"log_prob is of {k} joints, of which {len(columns)} are evaluated"
        return None, 0, [f"NLL: left out, because {what}. Declare dimensions where it is of others."]
    found = number_of_coordinates(k, d, root) if declared is None else declared
    lacking, remarks = poses_that_lack(counts, len(rows))
    own = number_of_coordinates(len(columns), d, root)
    if found != own:
        remarks.append(
            f"NLL: dimensions = {found} is declared, and the poses have {own} coordinates without the root "
            f"({len(columns)} joints × {d}): it is per dimension of {found}, and converted from the unit by as many."
        )
    attempt(problems, refuse_non_finite, f"{poses.name}: log_prob", values[rows], lacking, frames)
    return np.where(lacking, np.nan, values[rows] - found * math.log(factor)), found, remarks


def refuse_non_finite(name: str, values: FloatArray, lacking: BoolArray, frames: Sequence[str]) -> None:
    """Refuse log densities (m,) that are not finite, of poses that don't lack a joint.

    Raises
    ------
    PoseDataError
        With the first frames.
    """
    bad = np.flatnonzero(~np.isfinite(values) & ~lacking).tolist()
    if len(bad):
        infinite = " An infinite log density makes the NLL of all poses infinite." * bool(np.isinf(values).any())
        raise PoseDataError(
            f"{name} is not finite in {len(bad):,} of {len(values):,} frames (first: "
            f"{first_few([frames[row] for row in bad])}); expected nats.{infinite} Give the model a density above "
            "0 everywhere, such as a mixture with a wide component, or leave these frames out."
        )
