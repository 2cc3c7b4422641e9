"""Conformal radii about the median that hold the truth, per joint."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from posecal.data.arrays import FloatArray, checked_number
from posecal.data.checks import TINY, metres_message, pose_size
from posecal.data.pose_data import PoseData
from posecal.data.root import AnyRoot
from posecal.engine.block import Block
from posecal.engine.per_pose import iter_blocks
from posecal.engine.sums import mean_of
from posecal.errors import PoseDataError, for_python, option
from posecal.evaluation.sources import Source, as_pose_data
from posecal.metrics.sharpness import joint_deviations
from posecal.recalibration import folds as parts


@dataclass(frozen=True)
class RadiusMap:
    """A radius about the median that holds the truth, for each joint.

    Attributes
    ----------
    joints : tuple of str
        K names.
    radii : array (K,)
        In the unit of the data, or where ``scaled`` multiples of the predicted standard deviation.
    alpha : float
        The share of truths that may lie outside.
    scaled : bool
        Whether the radius goes with the predicted spread of each pose.
    poses, sequences : int
        What it was fitted on.
    root : int, Root or None
        What positions were relative to.
    data_unit : str
        Of what it was fitted on: ``mm``, ``deg``, ``px``, or empty.
    data_remarks : tuple of str
        On what it was fitted on, as those of :class:`posecal.PoseData`; a file of the map does not hold them.
    """

    joints: tuple[str, ...]
    radii: FloatArray
    alpha: float
    scaled: bool
    poses: int
    sequences: int
    root: AnyRoot = None
    data_unit: str = "mm"
    data_remarks: tuple[str, ...] = ()

    @property
    def remarks(self) -> tuple[str, ...]:
        """What a careful reader should know about the data that it was fitted on."""
        return tuple(map(for_python, self.data_remarks))

    @property
    def by_joint(self) -> dict[str, float]:
        """The radii by the names of their joints."""
        return dict(zip(self.joints, self.radii.tolist(), strict=True))

    @property
    def unit(self) -> str:
        """The unit of the radii."""
        return "standard deviations" if self.scaled else self.data_unit

    def apply(
        self, hypotheses: npt.ArrayLike, /, *, axes: str | None = None, unit: str | float | None = None
    ) -> tuple[FloatArray, FloatArray]:
        """Give the balls of some poses.

        Parameters
        ----------
        hypotheses : array (N, M, K, D), or as ``axes`` says
            Hypotheses with the joints of the map.
        axes : str, optional
            Their layout, as for :func:`posecal.evaluate`; ``NMKD`` by default.
        unit : str or float, optional
            Their unit, that of the map by default; of angles ``deg`` or ``rad`` is needed.

        Returns
        -------
        centre : array (M, K, D)
            The per-coordinate median, relative to the root, in their unit; of angles within half a turn of 0.
        radius : array (M, K)
            In their unit; NaN for joints without. Of angles, more than half a turn holds all.

        Raises
        ------
        PoseDataError
            As :meth:`SpreadMap.apply`, and for radii in mm where hypotheses without a unit look like metres.
        """
        factor = parts.factor_of_unit(unit, self.data_unit)
        x, _, _ = parts.checked_for_map(hypotheses, axes, self.joints, self.poses)
        size = pose_size(x[:12, :16].reshape(-1, *x.shape[2:]))
        if unit is None and self.unit == "mm" and 0 < size < TINY:
            advice = f"Pass {option('unit', 'm')}, or {option('unit', 'mm')} if it is right."
            raise PoseDataError(f"{metres_message('hypotheses', size)} {advice}")
        radii = self.radii if self.scaled else self.radii / factor
        return balls(x, radii, self.root, scaled=self.scaled, period=parts.period_in(self.data_unit, factor))


def balls(
    hypotheses: FloatArray, radii: FloatArray, root: AnyRoot, *, scaled: bool, period: float | None = None
) -> tuple[FloatArray, FloatArray]:
    """Centres (M, K, D) and radii (M, K) of some poses, mm, relative to the root."""
    zeros = np.zeros(hypotheses.shape[1:])
    blocks = (lay_out() for lay_out in iter_blocks(hypotheses, zeros, root=root, period=period))
    centres_and_widths = [
        (b.shortest(b.median), joint_deviations(b) if scaled else np.ones(b.where.shape)) for b in blocks
    ]
    centre, width = map(np.concatenate, zip(*centres_and_widths, strict=True))
    return centre, radii * width


def _distances(data: PoseData, *, scaled: bool, threads: int | None) -> FloatArray:
    """Distance of the truth from the median, (M, K), also in predicted standard deviations; NaN for uncounted ones."""
    mask = parts.movable_joints(data)

    def measure(block: Block) -> FloatArray:
        distances = np.linalg.norm(block.shortest(block.median).astype(np.float64), axis=-1)
        if scaled:
            with np.errstate(divide="ignore", invalid="ignore"):
                distances = distances / joint_deviations(block)
        return np.where(block.where & mask, distances, np.nan)

    return np.concatenate(list(parts.measure_blocks(data, measure, threads)))


def _radii(distances: FloatArray, alpha: float) -> FloatArray:
    """The ⌈(n + 1)(1 - α)⌉-th smallest distance of each joint; NaN for joints that don't count."""
    number = (~np.isnan(distances)).sum(axis=0)
    rank = np.maximum(np.ceil((number + 1) * (1 - alpha) - 1e-9).astype(np.intp), 1)
    few = number[(number > 0) & (rank > number)]
    if few.size:
        raise PoseDataError(
            f"alpha: {alpha:g} needs more than {few.min()} poses; the smallest possible with them is "
            f"{1 / (few.min() + 1):.4g}."
        )
    radii: FloatArray = np.take_along_axis(np.sort(distances, axis=0), rank[None] - 1, axis=0)[0]
    return radii


def fit_radius(
    hypotheses: Source | PoseData,
    truth: Source | None = None,
    /,
    *,
    alpha: float = 0.1,
    scaled: bool = False,
    threads: int | None = None,
    **described: Any,
) -> RadiusMap:
    r"""Find the radius about the median that holds the truth of each joint in a share 1 - α of poses.

    .. math:: r_k = d_{(\lceil (n+1)(1-\alpha) \rceil)\,k}, \qquad
              d_{mk} = \lVert y_{mk} - \operatorname{median}_n x_{nmk} \rVert

    Parameters
    ----------
    hypotheses, truth : arrays, paths or PoseData
        As for :func:`posecal.evaluate`; n poses.
    alpha : float
        The share of truths that may lie outside, between 0 and 1.
    scaled : bool
        Whether distances count in multiples of the predicted standard deviation of the pose's joint, so that
        uncertain poses get larger balls.
    threads : int, optional
        One per core by default.
    **described
        Options that describe the data, as for :func:`posecal.evaluate`.

    Returns
    -------
    RadiusMap
        The radii.

    Raises
    ------
    PoseDataError
        For an α outside (0, 1), or smaller than 1/(n + 1), which no number of poses n allows.

    Notes
    -----
    The coverage is at least 1 - α for a new pose that is exchangeable with these. Frames of one video resemble each
    other, so fewer independent poses are behind it than their number says. Differs from the published code: none; ours.

    References
    ----------
    Angelopoulos and Bates, arXiv:2107.07511 (split conformal prediction).
    """
    data = _checked(as_pose_data(hypotheses, truth, described), alpha, scaled=scaled)
    radii = _radii(_distances(data, scaled=scaled, threads=threads), alpha)
    fitted = len(data.truth), parts.number_of_sequences(data), data.root, data.unit, parts.remarks_of(data)
    return RadiusMap(data.joints, radii, alpha, scaled, *fitted)


def _checked(data: PoseData, alpha: float, *, scaled: bool) -> PoseData:
    checked_number(alpha, "alpha", lambda value: 0 < value < 1, "between 0 and 1")
    return parts.select_fitted(data, 2 if scaled else 1)


def held_out_coverage(
    hypotheses: Source | PoseData,
    truth: Source | None = None,
    /,
    *,
    alpha: float = 0.1,
    scaled: bool = False,
    folds: int = 5,
    threads: int | None = None,
    **described: Any,
) -> FloatArray:
    """Share of held-out truths inside the radius that was fitted on the other sequences, per joint.

    Parameters
    ----------
    hypotheses, truth, alpha, scaled, threads, **described
        As for :func:`fit_radius`.
    folds : int
        Parts into which the sequences are cut.

    Returns
    -------
    array (K,)
        Shares; 1 - α is meant. NaN for joints that don't count.

    Raises
    ------
    PoseDataError
        As :func:`fit_radius`, and for fewer sequences than parts.
    """
    data = _checked(as_pose_data(hypotheses, truth, described), alpha, scaled=scaled)
    fold_of = parts.folds_of(data, folds)
    distances = _distances(data, scaled=scaled, threads=threads)
    radii = np.stack([_radii(distances[fold_of != fold], alpha) for fold in range(folds)])
    counted = ~np.isnan(distances)
    return mean_of((counted & (distances <= radii[fold_of])).sum(axis=0), counted.sum(axis=0))
