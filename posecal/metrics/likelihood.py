"""Negative log-likelihood: the model's own log density at the true pose, alone and against climatology's Gaussian.

The density of a pose of d coordinates is in 1 / unit^d, so its logarithm depends on the unit: in millimetres it is
d · log(1000) smaller than in metres. It has no bound where true poses don't fill their space: a coordinate that follows
from others, or a bone of constant length, lets a model gain without end by being narrow there.

References: Good (1952), J. R. Stat. Soc. B 14, 107 (the logarithmic score); Gneiting and Raftery,
doi:10.1198/016214506000001437.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import partial

import numpy as np
import numpy.typing as npt

from posecal.data.arrays import FloatArray, as_labels, real_array
from posecal.data.log_density import as_dimensions, as_log_prob, number_of_coordinates
from posecal.data.root import resting_joints
from posecal.data.skeleton import Skeleton
from posecal.data.units import quantity
from posecal.engine.block import Block
from posecal.engine.finish import MEAN
from posecal.engine.metric import Metric, Statistic
from posecal.engine.scope import DataSpec, Scope
from posecal.engine.sums import Counts, Indices, split_by
from posecal.engine.truth_moments import (
    constraints,
    gaussian_log_density,
    gaussians_of_others,
    moments,
    own_log_density,
)
from posecal.errors import PoseDataError

LIKELIHOODS = ("nll", "nll_per_dimension", "log_likelihood_skill")
"""The metrics of this module."""

MOMENTS = "log_density_and_moments"
"""How the name begins of the statistic whose sums hold moments of true poses."""

MOST_DIMENSIONS = 96
"""Poses of more coordinates have no climatology's Gaussian: the products of all pairs would take too much memory."""

SMALLEST_GAIN = 1.0
"""A skill that gains this by the errors of climatology's estimate, nats, has a remark."""

SMALLEST_DEVIATION = 0.1
"""Truths that vary less than this in some direction, mm, obey a constraint: no motion capture resolves it."""


def nll(log_prob: npt.ArrayLike, /, *, dimensions: int, unit: str | float) -> FloatArray:
    r"""Negative log-likelihood of each pose, as a density in millimetres.

    .. math:: -\log p_{mm} = -\log p_{unit} + d \log(\text{mm in one unit})

    Parameters
    ----------
    log_prob : array (M,)
        The model's log density at the true pose, nats, of coordinates in ``unit``.
    dimensions : int
        d, the number of coordinates that the density is over.
    unit : str or float
        Of these coordinates, as for :func:`posecal.evaluate`.

    Returns
    -------
    array (M,)
        Nats; lower is better, and there is no least value.

    Raises
    ------
    PoseDataError
        For other arrays, a number of dimensions that can't be, and unknown units.

    Notes
    -----
    Differs from the published code: that prints densities in the unit that its network works in.

    See Also
    --------
    climatology_log_prob : What a model that ignores the image gives.

    References
    ----------
    Good (1952), J. R. Stat. Soc. B 14, 107.

    Examples
    --------
    A density of 1 in one coordinate in metres is one of 0.001 in millimetres, and log(1000) = 6.9.

    >>> nll([0.0], dimensions=1, unit="m").round(1), nll([0.0], dimensions=1, unit="mm") + 0.0
    (array([6.9]), array([0.]))
    """
    values = as_log_prob(log_prob, "log_prob")
    return as_dimensions(dimensions, "dimensions") * math.log(quantity(unit)[1]) - values


def climatology_log_prob(truth: npt.ArrayLike, sequence: npt.ArrayLike | None = None, /) -> FloatArray:
    r"""Log density of each true pose under the Gaussian of the true poses of all other sequences.

    .. math:: \log \mathcal{N}(y_m; \mu_{-s(m)}, \Sigma_{-s(m)})

    Parameters
    ----------
    truth : array (M, d) or (M, K, D)
        True poses, without the root, in the unit that the density is wanted in.
    sequence : array (M,), optional
        The sequence of each pose; each pose is one by default.

    Returns
    -------
    array (M,)
        Nats; NaN where the other poses are too few, or vary in fewer than d directions.

    Raises
    ------
    PoseDataError
        For what are no poses, coordinates that are not finite, and other than one sequence per pose.

    Notes
    -----
    Leaving a pose's own sequence out makes it a forecast: a Gaussian that was fitted to the poses that it judges would
    give them too high a density. Differs from the published code: none; ours.

    Examples
    --------
    The others of the last pose are at -1 and 1: their mean is 0 and their variance (n - 1) is 2.

    >>> climatology_log_prob(np.array([[-1.0], [1.0], [0.0]]))[-1].round(4) == np.round(-np.log(4 * np.pi) / 2, 4)
    np.True_
    """
    poses = real_array(truth, "truth").astype(np.float64)
    if poses.ndim not in (2, 3) or not poses.size or not np.isfinite(poses).all():
        raise PoseDataError(f"truth: {poses.shape}; expected (M, d) or (M, K, D), at least one pose, all finite.")
    poses = poses.reshape(len(poses), -1)
    names = np.arange(len(poses)) if sequence is None else as_labels(sequence, "sequence")
    if names.shape != (len(poses),):
        raise PoseDataError(f"sequence: {names.shape}; expected one per pose, ({len(poses)},).")
    own, number = np.unique(names, return_inverse=True)[1], np.unique(names, return_counts=True)[1]
    rows, found = split_by(own, len(number)), np.full(len(poses), np.nan)
    sums = np.stack([moments(poses[some]).sum(axis=0) for some in rows])
    for some, (mean, covariance) in zip(rows, gaussians_of_others(sums, number, poses.shape[1]) or [], strict=False):
        away = poses[some] - mean
        distances = (away * np.linalg.solve(covariance, away.T).T).sum(axis=1)
        found[some] = -(distances + np.linalg.slogdet(2 * math.pi * covariance)[1]) / 2
    return found


# --- metrics ------------------------------------------------------------------------------------------------------


def negative_log_density(block: Block) -> FloatArray:
    """Negative log density of each pose of a block, (B,), nats; NaN for poses without one."""
    assert block.log_prob is not None
    return np.asarray(-block.log_prob)


def log_density_and_moments(block: Block, joints: Indices, bones: tuple[tuple[int, int], ...]) -> FloatArray:
    """Log density of each pose, what Gaussians of true poses are made of, and lengths of bones.

    Parameters
    ----------
    block : Block
        B poses with their log densities.
    joints : array of int
        Those that are not the root.
    bones : tuple of pairs of int
        Parent and child of each of E bones.

    Returns
    -------
    array (B, 1 + d + d (d + 1) / 2 + 2 E)
        The log density, the coordinates, the products of all pairs of them, the lengths and their squares; NaN for
        poses that lack a joint.
    """
    truth = block.truth.astype(np.float64)
    parents, children = np.array(bones, dtype=np.intp).reshape(-1, 2).T
    lengths = np.linalg.norm(truth[:, children] - truth[:, parents], axis=-1)
    of_pose = moments(truth[:, joints].reshape(len(truth), -1))
    values = np.concatenate([-negative_log_density(block)[:, None], of_pose, lengths, lengths**2], axis=1)
    values[~block.where.all(axis=1)] = np.nan
    return values


def _with_climatology(sums: FloatArray, counts: Counts, sequence: Indices, *, spec: DataSpec) -> FloatArray:
    """Sums of the model's log densities and of climatology's, (C, 2)."""
    of_climatology = np.full(len(sums), np.nan)
    if _coordinates(spec) == spec.dimensions:
        _, of_poses, _ = _split(sums, spec)
        of_climatology = gaussian_log_density(of_poses, counts, sequence, spec.dimensions, _smallest_deviation(spec))
    return np.stack([sums[:, 0], of_climatology], axis=1)


def _split(sums: FloatArray, spec: DataSpec) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Split sums of :func:`log_density_and_moments` into log densities, moments, and lengths (C, 2, E)."""
    number = len(_bones(spec))
    stop = sums.shape[1] - 2 * number
    return sums[:, 0], sums[:, 1:stop], sums[:, stop:].reshape(len(sums), 2, number)


def _coordinates(spec: DataSpec) -> int:
    return number_of_coordinates(len(spec.joints), spec.n_coordinates, spec.root)


def _bones(spec: DataSpec) -> tuple[tuple[int, int], ...]:
    return tuple(Skeleton(spec.joints, spec.parents).bones)


def _smallest_deviation(spec: DataSpec) -> float:
    return SMALLEST_DEVIATION if spec.unit == "mm" else 0.0


def moments_statistic(scope: Scope) -> Statistic | None:
    """Give the statistic of log densities and true poses; None without a density, and of too many coordinates."""
    spec, d = scope.spec, _coordinates(scope.spec)
    if not spec.dimensions or d > MOST_DIMENSIONS or spec.period is not None:
        return None
    joints = np.setdiff1d(np.arange(len(spec.joints)), resting_joints(spec.root))
    return Statistic(
        f"{MOMENTS}_{spec.dimensions}",
        partial(log_density_and_moments, joints=joints, bones=_bones(spec)),
        derive=partial(_with_climatology, spec=spec),
    )


def likelihood_metrics(scope: Scope) -> Iterator[Metric]:
    """NLL, alone and against climatology, of models that give their log density at the true pose."""
    d = scope.spec.dimensions
    if not d:
        return
    over = f"d={d} coordinates in {'mm' if scope.spec.unit else 'their own unit'}"
    make = partial(
        Metric,
        unit="nats",
        direction="lower",
        family="scores",
        headline=True,
        needs=("whole poses",),
        statistic=Statistic(f"nll_{d}", negative_log_density),
        range="no bound on either side",
        source="Good (1952), J. R. Stat. Soc. B 14, 107; Gneiting and Raftery, doi:10.1198/016214506000001437",
    )
    yield make(
        name="nll",
        label="NLL",
        brief=f"−log p(truth) over {over}",
        definition=f"mean over poses of −log p(truth), the model's own log density at the true pose, over {over}",
        finish=MEAN,
        in_group_table=True,
        reading="Proper and local: only the density at the truth counts. Only differences between models of the same "
        "coordinates mean something. Where true poses obey constraints (rigid bones, a hip that follows from the "
        "other, planar data) it has no bound, and does not rank models. A few poses may make up most of it.",
    )
    yield make(
        name="nll_per_dimension",
        label="NLL per dimension",
        brief=f"NLL / {d}",
        definition=f"mean over poses of −log p(truth) / d, over {over}",
        finish=lambda means: np.asarray(means) / d,
        reading="In another unit it differs by the logarithm of the factor: 6.908 lower in metres. A Gaussian of "
        "standard deviation s mm that is right has log(s) + 1.419.",
    )
    statistic = moments_statistic(scope)
    if statistic is not None:
        yield make(
            name="log_likelihood_skill",
            label="log-likelihood skill",
            direction="higher",
            brief="log p − log p of a Gaussian of other sequences' truths",
            definition="mean over poses of log p(truth) − log g(truth), g: the Gaussian with the mean and covariance "
            f"of the true poses of all other sequences, over {over}",
            statistic=statistic,
            finish=lambda means: np.asarray(means[..., 0] - means[..., 1]),
            range="no bound on either side; below 0 the model is worse than a Gaussian that ignores the image",
            reading="What the model gains by the image, in nats: it depends on no unit. With few sequences the "
            "Gaussian is a poor forecast, and the skill is too high.",
        )


def lack_of_likelihood(spec: DataSpec) -> str:
    """Say what the data lack that a metric of this module needs, where they can't have it."""
    if not spec.dimensions:
        return (
            "needs the model's log densities. Store log_prob beside the hypotheses, with dimensions where it is of "
            "other joints than those that are evaluated."
        )
    return f"needs poses of at most {MOST_DIMENSIONS} coordinates, and no angles."


def is_unbounded(scope: Scope, sums: FloatArray, counts: Counts, sequence: Indices) -> bool:
    """Whether the true poses obey constraints, so that a density has no bound; see :func:`likelihood_remarks`."""
    spec = scope.spec
    _, of_poses, lengths = _split(sums, spec)
    found = constraints(of_poses, lengths, counts, sequence, _coordinates(spec), _smallest_deviation(spec))
    return found is not None and found.directions + found.bones > 0


def likelihood_remarks(
    scope: Scope, sums: FloatArray | None, counts: Counts, sequence: Indices, of_others: float = math.nan
) -> Iterator[str]:
    """Say which constraints of the true poses make a likelihood meaningless, and why climatology's is missing.

    Parameters
    ----------
    scope : Scope
        What was measured, and the options.
    sums : array (C, …) or None
        Of the statistic of :func:`moments_statistic`, where there is one.
    counts, sequence : arrays (C,)
        Poses, and the sequence of each cell.
    of_others : float
        The mean log density under climatology's Gaussian.
    """
    spec, d = scope.spec, _coordinates(scope.spec)
    if d > MOST_DIMENSIONS:
        yield (
            f"NLL: poses of {d:,} coordinates are not searched for constraints, and have no climatology (at most "
            f"{MOST_DIMENSIONS}). Where some coordinates follow from others it has no bound, and does not rank models."
        )
    if sums is None:
        return
    _, of_poses, lengths = _split(sums, spec)
    found = constraints(of_poses, lengths, counts, sequence, d, _smallest_deviation(spec))
    if found is None:
        yield (
            f"NLL: {int(counts.sum()):,} complete poses are too few to estimate climatology's Gaussian of {d} "
            "coordinates, or to search for constraints."
        )
        return
    kinds = []
    if found.directions:
        least = f" (standard deviation below {SMALLEST_DEVIATION} mm)" if spec.unit == "mm" else ""
        kinds.append(f"don't vary in {found.directions} of {found.of_directions} directions{least}")
    if found.bones:
        kinds.append(f"have {found.bones} of {found.of_bones} bones of constant length within each sequence")
    if kinds:
        yield (
            f"NLL: the true poses {' and '.join(kinds)}. A density has no bound there, so that the NLL does not rank "
            "models: take a score of samples, such as the energy score."
        )
    lacks = "log_likelihood_skill: no value, because"
    if d != spec.dimensions:
        yield f"{lacks} the density is over {spec.dimensions} coordinates and the poses have {d}."
    elif found.directions:
        yield f"{lacks} climatology's Gaussian is singular."
    elif math.isnan(of_others):
        yield f"{lacks} the poses of some sequence can't be judged by those of the others, which are too few."
    else:  # own poses are given about as much too high a density as others' are given too low a one
        n = int(counts.sum())
        gain = (own_log_density(of_poses.sum(axis=0), n, d) - of_others) / 2
        if gain >= SMALLEST_GAIN:
            yield (
                f"log_likelihood_skill: about {gain:.1f} nats of it are because the {d} coordinates of climatology's "
                f"Gaussian are estimated from too few independent poses."
            )
