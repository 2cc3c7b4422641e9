"""Spread maps: a factor of each joint, by which hypotheses are moved away from their centre, or towards it.

The centre is the per-coordinate median of a pose's hypotheses, or, at joints with several modes, that of the mode
which a hypothesis belongs to: x ← c + s (x - c). Of angles x - c is the shorter way round, and so is what it becomes: a
spread of more than half a turn goes on round the circle.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt

from posecal.calibration.modes import centres_of_modes
from posecal.data.arrays import BoolArray, FloatArray
from posecal.data.fitted_poses import Hashes, fitted_remarks
from posecal.data.pose_data import PoseData
from posecal.data.root import AnyRoot, origin
from posecal.data.stored_poses import Hypotheses, Rows
from posecal.data.units import PERIODS
from posecal.engine.circular import wrapped
from posecal.engine.per_pose import iter_blocks
from posecal.errors import for_python
from posecal.recalibration import folds as parts
from posecal.recalibration.effect import objections


@dataclass(frozen=True)
class SpreadMap:
    """A factor of the spread of each joint.

    Attributes
    ----------
    joints : tuple of str
        K names.
    factors : array (K,)
        s of each joint; above 1 widens.
    poses, sequences : int
        What it was fitted on.
    root : int, Root or None
        What positions were relative to.
    data_unit : str
        Of what it was fitted on: ``mm``, ``deg``, ``px``, or empty.
    data_remarks : tuple of str
        On what it was fitted on, as those of :class:`posecal.PoseData`; a file of the map does not hold them.
    modal : tuple of str
        The joints whose hypotheses are rescaled about the mode that they belong to, not about their median.
    changes : mapping of tuples
        Metrics of the poses that it was fitted on, before and after: ``energy_score``, ``crps``, ``ece``,
        ``signed_area``, ``min_mpjpe``. In sample, so a little too good; empty where it was not fitted.
    fitted_on : array (H,)
        Hashes of the true poses that it was fitted on; see :mod:`posecal.data.fitted_poses`.
    """

    joints: tuple[str, ...]
    factors: FloatArray
    poses: int
    sequences: int
    root: AnyRoot = None
    data_unit: str = "mm"
    data_remarks: tuple[str, ...] = ()
    modal: tuple[str, ...] = ()
    changes: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    fitted_on: Hashes = field(default_factory=lambda: np.zeros(0, dtype=np.uint64))

    @property
    def remarks(self) -> tuple[str, ...]:
        """What a careful reader should know about the data that it was fitted on, and the objections to the map."""
        against = [f"Not recommended: {' and '.join(self.objections)}."] if self.objections else []
        return (*map(for_python, self.data_remarks), *against)

    @property
    def objections(self) -> tuple[str, ...]:
        """Why the map should not be used: what it makes worse on the poses that it was fitted on; empty for none."""
        return objections(self.changes, self.data_unit)

    @property
    def about_modes(self) -> BoolArray:
        """The joints whose hypotheses are rescaled about their mode, (K,)."""
        return np.isin(self.joints, self.modal)

    @property
    def by_joint(self) -> dict[str, float]:
        """The factors by the names of their joints."""
        return dict(zip(self.joints, self.factors.tolist(), strict=True))

    def apply(
        self, hypotheses: npt.ArrayLike, /, *, axes: str | None = None, unit: str | float | None = None
    ) -> FloatArray:
        """Rescale the dispersion of hypotheses.

        Parameters
        ----------
        hypotheses : array (N, M, K, D), or as ``axes`` says
            Hypotheses with the joints of the map, in any unit.
        axes : str, optional
            Their layout, as for :func:`posecal.evaluate`; ``NMKD`` by default.
        unit : str or float, optional
            Their unit, which only a map of angles needs: ``deg`` or ``rad``.

        Returns
        -------
        array in the same layout, without an axis ``I``
            c + s (x - c), in the same unit; c is the per-coordinate median of a pose's hypotheses, or of those of
            one mode.

        Raises
        ------
        PoseDataError
            For another number of joints, arrays of another shape, type or quantity, a layout that is none, angles
            without a unit, where no layout is given and only the first axis has the length of the poses that the map
            was fitted on, for columns that are no coordinates, coordinates that are infinite or beyond 1e7, and joints
            that only some hypotheses have.
        """
        factor = parts.factor_of_unit(unit, self.data_unit)
        x, layout, clip_length = parts.checked_for_map(hypotheses, axes, self.joints, self.poses)
        period = parts.period_in(self.data_unit, factor)
        return layout.store(rescaled(x, self.factors, self.root, period, self.about_modes), clip_length)

    def rescale(self, data: PoseData) -> PoseData:
        """Give pose data whose hypotheses are rescaled when they are read.

        Raises
        ------
        PoseDataError
            For another quantity than the map's, joints that it lacks, and unequal weights.
        """
        parts.refuse_weights(data.weights, data.names[0])
        parts.refuse_another_unit(data.names[0], data.unit, self.data_unit)
        factors = parts.values_for_joints(self.joints, self.factors, data.joints, data.names[0])
        about_modes = parts.values_for_joints(self.joints, self.about_modes, data.joints, data.names[0])
        moved = RescaledHypotheses(data.hypotheses, factors, data.root, PERIODS.get(data.unit), about_modes)
        remarks = (*data.remarks, *fitted_remarks(self.fitted_on, data.truth, data.names[0]))
        density = {"log_prob": None, "dimensions": 0}  # of another distribution
        return data.replace(hypotheses=moved, remarks=remarks, **density)


@dataclass(frozen=True)
class RescaledHypotheses:
    """Hypotheses whose spread about their median is multiplied when they are read.

    Attributes
    ----------
    hypotheses : Hypotheses
        As they were.
    factors : array (K,)
        s of each joint.
    root : int or None
        The joint to which spreads are relative.
    period : float or None
        After how much coordinates repeat.
    about_modes : bool array (K,), optional
        The joints whose hypotheses are rescaled about their mode.
    """

    hypotheses: Hypotheses
    factors: FloatArray
    root: AnyRoot
    period: float | None = None
    about_modes: BoolArray | None = None

    @property
    def n_hypotheses(self) -> int:
        """N."""
        return self.hypotheses.n_hypotheses

    @property
    def itemsize(self) -> int:
        """Bytes of a coordinate."""
        return self.hypotheses.itemsize

    def select(self, poses: Rows) -> RescaledHypotheses:
        """Keep some poses, by their numbers."""
        return replace(self, hypotheses=self.hypotheses.select(poses))

    def read(self, start: int, stop: int) -> FloatArray:
        """Read some poses, (N, stop - start, K, D) in mm."""
        return rescaled(self.hypotheses.read(start, stop), self.factors, self.root, self.period, self.about_modes)


def rescaled(
    hypotheses: FloatArray,
    factors: FloatArray,
    root: AnyRoot = None,
    period: float | None = None,
    about_modes: BoolArray | None = None,
) -> FloatArray:
    """Multiply the spread of hypotheses about their per-coordinate median, or that of their mode.

    Parameters
    ----------
    hypotheses : array (N, M, K, D)
        Hypotheses, mm.
    factors : array (K,)
        s of each joint.
    root : int or Root, optional
        What positions are relative to; it keeps its own spread.
    period : float, optional
        After how much coordinates repeat, such as 360 for degrees.
    about_modes : bool array (K,), optional
        The joints whose hypotheses are rescaled about the mode that each belongs to.

    Returns
    -------
    array (N, M, K, D)
        c + s (x - c), in the precision of the hypotheses.
    """
    start = 0 if root is None else origin(hypotheses, root)
    zeros = np.zeros(hypotheses.shape[1:], dtype=hypotheses.dtype)
    blocks = iter_blocks(hypotheses, zeros, root=root, period=period)
    if about_modes is None or not about_modes.any():
        centre = np.concatenate([lay_out().median for lay_out in blocks])
    else:
        centre = np.concatenate([centres_of_modes(lay_out(), about_modes) for lay_out in blocks]).transpose(3, 0, 1, 2)
    times = factors.astype(centre.dtype)[:, None]
    if period is not None:  # what does not change stays as it is written
        away = wrapped(hypotheses - start - centre, period)
        return hypotheses + (wrapped(times * away, period) - away)
    moved: FloatArray = centre + times * (hypotheses - start - centre) + start
    return moved
