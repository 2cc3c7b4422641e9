"""Hypotheses drawn from the distributions that a model states, as they are read, and the density of the truth."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from posecal.data.archive import Header, Member, open_archive
from posecal.data.arrays import BoolArray, FloatArray
from posecal.data.file_array import FileArray, open_member, opened
from posecal.data.gaussian import GaussianPrediction, counting
from posecal.data.log_density import number_of_coordinates, poses_that_lack, refuse_non_finite
from posecal.data.remarks import Remark
from posecal.data.root import AnyRoot, resting_joints, root_joints, root_name
from posecal.data.stored_poses import Rows, StoredPoses
from posecal.data.units import PERIODS
from posecal.errors import PosecalError, attempt, checked_integer, option, raise_all

STATED = ("mean", "covariance", "sigma", "mixture_weights")
"""Members of a file of distributions."""

N_DRAWS = 200
"""Hypotheses that are drawn of each pose by default."""


@dataclass(frozen=True)
class DrawnHypotheses:
    """Hypotheses that are drawn when they are read, as a :class:`posecal.data.layout.LazyArray` (N, M, K, D).

    Attributes
    ----------
    prediction : GaussianPrediction
        What they are drawn from.
    n : int
        N.
    seed : int
        Of the generators.
    """

    prediction: GaussianPrediction
    n: int = N_DRAWS
    seed: int = 0

    @property
    def shape(self) -> tuple[int, ...]:
        """The length of every axis."""
        return (self.n, *self.prediction.shape)

    @property
    def dtype(self) -> np.dtype[np.generic]:
        """The type of its numbers."""
        return self.prediction.dtype

    def part(self, where: tuple[slice, ...]) -> npt.NDArray[np.generic]:
        """Draw a range of every axis."""
        draws, frames, *others = where
        drawn = self.prediction.sample_frames(frames.start, frames.stop, self.n, self.seed)
        return drawn[(draws, slice(None), *others)]

    @property
    def remark(self) -> Remark:
        """What they are, in words."""
        c = len(self.prediction.weights)
        kind = "the Gaussian" if c == 1 else f"the mixture of {c} Gaussians"
        return Remark(f"N = {self.n:,} draws from {kind} that the model states for each pose, seed {self.seed}.")


def is_stated(headers: Mapping[str, Header]) -> bool:
    """Whether a file of hypotheses holds distributions."""
    names = {*headers}
    return "mean" in names and bool({"covariance", "sigma"} & names) and not {"hypotheses", "hyps"} & names


def open_distributions(path: Path, stored: Mapping[str, Member]) -> DrawnHypotheses:
    """Open the distributions of an ``.npz`` file, which are read where they lie."""
    names = [name for name in STATED[:3] if name in stored]
    arrays: dict[str, Any] = {name: _opened_member(path, name) for name in names}
    if "mixture_weights" in stored:
        arrays["mixture_weights"] = stored["mixture_weights"].read()
    return DrawnHypotheses(GaussianPrediction(**arrays, name=path.name))


def _opened_member(path: Path, name: str) -> FileArray:
    """Open one array in a file of its own, which is closed with it."""
    with opened(path) as file:
        array = open_member(open_archive(file, path.name)[name], file, path)
    if array.file is not file:
        file.close()
    return array


def with_draws(poses: StoredPoses, draws: object = None, seed: object = None) -> StoredPoses:
    """Set how many hypotheses are drawn, and by which seed.

    Raises
    ------
    PoseDataError
        For numbers that can't be.
    """
    changes: dict[str, Any] = {
        name: checked_integer(value, option(given), least)
        for name, given, value, least in (("n", "draws", draws, 1), ("seed", "seed", seed, 0))
        if value is not None
    }
    if not isinstance(poses.array, DrawnHypotheses):
        return poses
    return replace(poses, array=replace(poses.array, **changes))


def with_counts(poses: StoredPoses, rows: Rows, columns: Rows, counts: BoolArray | None) -> StoredPoses:
    """Say of which frames and joints distributions count, as :func:`posecal.data.gaussian.counting`."""
    array = poses.array
    if not isinstance(array, DrawnHypotheses):
        return poses
    return replace(poses, array=replace(array, prediction=counting(array.prediction, rows, columns, counts)))


def stated_log_density(
    poses: StoredPoses,
    truth: FloatArray,
    names: Sequence[str],
    unit: str,
    counts: BoolArray | None,
    rows: Rows,
    columns: Rows,
    frames: Sequence[str],
    root: AnyRoot,
    factor: float,
    problems: list[str | PosecalError],
) -> tuple[FloatArray | None, int, list[str]]:
    """Give the exact log density of the stated distributions at the true poses, in the unit that is measured in.

    Parameters
    ----------
    poses : StoredPoses
        Of drawn hypotheses.
    truth : array (m, k, D)
        True poses, in ``unit``.
    names : sequence of str
        Of joints, for messages.
    unit : str
        What is measured in.
    counts : bool array (m, k) or None
        The joints that count; poses that lack one have no density.
    rows, columns : arrays of int (m,) and (k,)
        The stored frames and joints that they belong to.
    frames : sequence of str
        Their names, for messages.
    root : int, Root or None
        What positions are relative to, among these joints.
    factor : float
        How many of it are in one unit of the file.
    problems : list
        What does not fit is added to it.

    Returns
    -------
    log_prob : array (m,) or None
        Nats; NaN where a joint is not known, and None where there is none.
    dimensions : int
        The number of coordinates that it is over; 0 without it.
    remarks : list of str
        What a careful reader should know.
    """
    array = poses.array
    assert isinstance(array, DrawnHypotheses)
    if poses.log_prob is not None:
        problems.append(f"{poses.name}: log_prob beside distributions, which give it; expected one of the two.")
    remarks: list[str] = [array.remark]
    if unit in PERIODS:
        return None, 0, [*remarks, "NLL: left out, because a Gaussian does not repeat as angles do."]
    if set(root_joints(root)) > set(resting_joints(root)):
        what = f"positions relative to the midpoint {root_name(root, names)} have no density"
        return None, 0, [*remarks, f"NLL: left out, because {what}. {option('root_joint')} names a joint, or none."]
    density = partial(array.prediction.log_density, truth / factor, rows, columns, root, frames)
    log_prob = attempt(problems, density)
    if log_prob is None:
        raise_all(problems)  # before anything is drawn
    assert log_prob is not None
    number = number_of_coordinates(len(columns), truth.shape[2], root)
    lacking, remark = poses_that_lack(counts, len(rows))
    name = f"{poses.name}: the stated log density of the truth"
    attempt(problems, refuse_non_finite, name, log_prob, lacking, frames)
    return np.where(lacking, np.nan, log_prob - number * math.log(factor)), number, [*remarks, *remark]
