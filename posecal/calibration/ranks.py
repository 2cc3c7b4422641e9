"""Where does the truth fall among its hypotheses?

Every calibration number starts here: for each pose and joint, how far inside the ball that holds a share q of
the hypotheses is the truth? Three definitions are in use, and each has its own centre and its own rule. All count
integers; none compares a rounded Φ with a rounded q.

=================  ==================================  =================================================
definition         centre, per coordinate              the truth is inside the q-ball
=================  ==================================  =================================================
``exchangeable``   median of the N + 1 pooled points   with weight clip(((N+1) q - n_less)/(n_equal+1), 0, 1)
``paper``          median of the N hypotheses          where n_less_or_equal / N ≤ q
``reference``      lower of the two middle values      where the interpolated q-quantile of the
                                                       distances is strictly larger than the truth's
=================  ==================================  =================================================

n_less counts the hypotheses that lie nearer to the centre than the truth, n_equal those just as far.

If the truth and the hypotheses are exchangeable given the input (a perfect sampler), ``exchangeable`` has
E ω(q) = q exactly, for every N, D, distribution and dependence between the hypotheses, ties included. ``paper``
(the text of the publication) and ``reference`` (its released script) are biased at finite N, by rank
discreteness and by a centre that only the hypotheses pull; see :mod:`posecal.calibration.floor`.

References
----------
Pierzchlewicz et al., arXiv:2210.11179, section 3.1.
"""

from __future__ import annotations

from typing import Literal, get_args

import numpy as np
import numpy.typing as npt

from posecal.block import Block, FloatArray, squared_distances
from posecal.errors import PoseDataError, did_you_mean

__all__ = ["DEFINITIONS", "LEVELS", "Definition", "inside", "known_definition"]

Definition = Literal["exchangeable", "paper", "reference"]
DEFINITIONS: tuple[Definition, ...] = get_args(Definition)

LEVELS: FloatArray = np.arange(21) / 20
"""The quantile levels q of every calibration curve: 0, 0.05, … 1, both ends in."""


def known_definition(definition: str) -> Definition:
    """Check the name of a definition.

    Raises
    ------
    PoseDataError
        Where it is none of :data:`DEFINITIONS`.
    """
    for known in DEFINITIONS:
        if known == definition:
            return known
    raise PoseDataError(f"definition: {definition!r} is not known. {did_you_mean(definition, DEFINITIONS)}")


def inside(block: Block, definition: Definition = "exchangeable") -> FloatArray:
    """How far inside each q-ball of its hypotheses the truth lies.

    Parameters
    ----------
    block : Block
        B poses of K joints.
    definition : str
        One of :data:`DEFINITIONS`.

    Returns
    -------
    array (B, K, Q)
        Weights W in [0, 1] for the levels of :data:`LEVELS`, rising with q; NaN for joints that don't count and
        where there are fewer than two hypotheses. Their mean over poses is ω_k(q).
    """
    if block.n_hypotheses < 2:
        return np.full((*block.where.shape, LEVELS.size), np.nan)
    weights = {"exchangeable": _exchangeable, "paper": _paper, "reference": _reference}[definition](block)
    weights[~block.where] = np.nan
    return weights


def _exchangeable(block: Block) -> FloatArray:
    less, equal = (count[..., None] for count in exchangeable_counts(block))
    weights = (LEVELS * (block.n_hypotheses + 1) - less) / (equal + 1)
    return np.asarray(np.clip(weights, 0, 1, out=weights))


def exchangeable_counts(block: Block) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]:
    """Count the hypotheses nearer to the pooled centre than the truth, and those as near, (B, K) each."""
    middle, odd = divmod(block.n_hypotheses, 2)
    ordered, truth = block.sorted, block.truth
    # The i-th of the pooled values is the truth, clipped to the (i-1)-th and i-th of the hypotheses'.
    centre = np.clip(truth, ordered[..., middle - 1], ordered[..., middle])
    if odd:
        centre = (centre + np.clip(truth, ordered[..., middle], ordered[..., middle + 1])) / 2
    squares = squared_distances(block.points, centre)
    return count_nearer(squares[..., :-1], squares[..., -1:])


def count_nearer(hypotheses: FloatArray, truth: FloatArray) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]:
    """Count along the last axis the values below the truth's, and those equal to it."""
    less = np.count_nonzero(hypotheses < truth, axis=-1)
    return less, np.count_nonzero(hypotheses <= truth, axis=-1) - less


def _paper(block: Block) -> FloatArray:
    squares = squared_distances(block.points, block.median)
    at_most = np.count_nonzero(squares[..., :-1] <= squares[..., -1:], axis=-1)
    allowed = np.arange(LEVELS.size) * block.n_hypotheses // (LEVELS.size - 1)  # floor(q N), in integers
    return (at_most[..., None] <= allowed).astype(np.float64)


def _reference(block: Block) -> FloatArray:
    """The truth's fractional place among the N distances, against the place q (N - 1) of the quantile.

    With ε_(i) ≤ ε* < ε_(i+1) (counted from 0), the interpolated quantile exceeds ε* exactly where
    q (N - 1) > i + (ε* - ε_(i)) / (ε_(i+1) - ε_(i)). The fraction matters to few of the poses, so only those few
    look for their two neighbours.
    """
    n = block.n_hypotheses
    distances = np.sqrt(squared_distances(block.points, block.sorted[..., (n - 1) // 2]))
    nearer = distances[..., :-1] <= distances[..., -1:]
    at_most = np.count_nonzero(nearer, axis=-1)
    targets = np.arange(LEVELS.size) * (n - 1)  # twenty times the quantile's place: integers
    whole, twentieths = np.divmod(targets, LEVELS.size - 1)

    place = at_most - 1.0  # -1 inside all, N - 1 outside all
    between = np.isin(at_most - 1, whole[twentieths > 0])
    if between.any():
        hypotheses, truth = distances[between][:, :-1], distances[between][:, -1]
        below = np.where(nearer[between], hypotheses, -np.inf).max(axis=-1)
        above = np.where(nearer[between], np.inf, hypotheses).min(axis=-1)
        place[between] += (truth - below) / (above - below)
    return np.asarray(targets / (LEVELS.size - 1) > place[..., None], dtype=np.float64)
