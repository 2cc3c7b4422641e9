"""What is a reported number? A statistic of every pose, and the way in which its mean becomes the number.

``finish(sum over poses of a per-pose statistic)``: nothing else is needed for files larger than memory, groups of
poses, shards on several machines, or resampling by sequence, because sums add. Each number carries its
definition, written out for the :class:`Protocol` and the :class:`DataSpec` that it was made with.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Literal

import numpy as np

from posecal.data.arrays import BoolArray, FloatArray
from posecal.data.skeleton import JOINT_SETS
from posecal.engine.block import Block
from posecal.engine.protocol import Protocol, named_joints
from posecal.errors import PoseDataError
from posecal.stats.resampling import Deviation

__all__ = ["TRUE_POSES", "Curve", "DataSpec", "Direction", "Family", "Metric", "Scope", "Statistic", "item"]

Direction = Literal["lower", "higher", "zero", "none"]
Family = Literal["accuracy", "calibration", "rank_tests", "scores", "spread"]


@dataclass(frozen=True)
class DataSpec:
    """What is measured: everything about a pair of arrays that a definition depends on.

    Attributes
    ----------
    n_hypotheses : int
        N.
    joints : tuple of str
        K names.
    root : int or None
        The joint that is subtracted from every pose.
    labels : tuple of str
        Names of the labels that every pose has.
    fps : float or None
        Frames per second.
    scored : bool
        Whether the model scored its hypotheses.
    marked : bool
        Whether occluded joints are marked.
    preranks : tuple of str
        Names of the user's own pre-ranks.
    reference : str
        What skills are relative to; empty without skills.
    n_reference : int
        Its number of hypotheses.
    masked : bool
        Whether the user left out joints of some poses by a mask of their own.
    """

    n_hypotheses: int
    joints: tuple[str, ...]
    root: int | None = None
    labels: tuple[str, ...] = ()
    fps: float | None = None
    scored: bool = False
    marked: bool = False
    preranks: tuple[str, ...] = ()
    reference: str = ""
    n_reference: int = 0
    masked: bool = False


@dataclass(frozen=True)
class Statistic:
    """A number or a table of every pose, to be summed.

    Attributes
    ----------
    name : str
        Unique within a protocol.
    compute : callable
        From a block to (B, *shape); NaN where a pose (or a joint of it) does not count.
    per_joint : bool
        Whether the first axis of the shape is joints, each of which counts or not.
    kept : bool
        Whether the numbers are kept pose by pose, for orders over poses, which no sums give.
    """

    name: str
    compute: Callable[[Block], FloatArray]
    per_joint: bool = False
    kept: bool = False


@dataclass(frozen=True)
class Metric:
    """A reported number, with everything one must know to read it.

    Attributes
    ----------
    name : str
        In snake case, as in JSON.
    label : str
        For people.
    unit : str
        ``mm``, ``mm/s``, ``mm/frame`` or empty.
    direction : str
        ``lower`` or ``higher`` is better, ``zero`` is best, or ``none``.
    family : str
        ``accuracy``, ``calibration``, ``battery``, ``scores`` or ``spread``.
    brief : str
        The same in a few words, for a table.
    definition : str
        One line, with the numbers it was made with.
    statistic : Statistic
        What is summed over poses.
    finish : callable
        From the mean of the statistic over poses to the number; from its values (M, ...) where they are kept.
    by_joint : tuple of Statistic and callable, or None
        What is summed, and from its mean to one number per joint, NaN for joints that don't count.
    clips : int
        0: the mean is over poses. k: ``finish`` is applied to the mean over each k sequences, and the mean of
        that, weighted with their poses, is the number.
    headline : bool
        Whether the default report shows it.
    deviation : Deviation or None
        Of calibration errors: how the error is made of mean deviations, so that sign-flips can test it.
    offset : array (Q,) or None
        With it: what a perfect sampler's curve is off by at this N.
    fires : str
        Of tests: what it means when it rejects.
    """

    name: str
    label: str
    unit: str
    direction: Direction
    family: Family
    brief: str
    definition: str
    statistic: Statistic
    finish: Callable[[FloatArray], float]
    by_joint: tuple[Statistic, Callable[[FloatArray], FloatArray]] | None = None
    sequences_per_batch: int = 0
    headline: bool = False
    deviation: Deviation | None = None
    offset: FloatArray | None = None
    fires: str = ""

    @property
    def statistics(self) -> tuple[Statistic, ...]:
        """Every statistic that the number and its joints' numbers need."""
        return (self.statistic,) if self.by_joint is None else (self.statistic, self.by_joint[0])


@dataclass(frozen=True)
class Curve:
    """A number as a function of another, for pictures.

    Attributes
    ----------
    name : str
        In snake case.
    at : array (T,)
        Where the function is known.
    axes : tuple of two str
        What the two axes show, with units.
    definition : str
        One line.
    statistic : Statistic
        Its mean over poses, (T,), is the curve.
    """

    name: str
    at: FloatArray
    axes: tuple[str, str]
    definition: str
    statistic: Statistic


TRUE_POSES = Statistic("truth", lambda block: block.truth.sum(axis=(1, 2), dtype=np.float64))
"""Sum of a true pose's coordinates: not a metric, but what tells whether two results were held against one truth."""


def item(*place: int) -> Callable[[FloatArray], float]:
    """Finish by reading one entry of the mean."""
    return lambda mean: float(mean[place])


@dataclass(frozen=True)
class Scope:
    """Which joints each kind of metric is about, from what is asked and what is there.

    Attributes
    ----------
    protocol : Protocol
        The options.
    spec : DataSpec
        What is measured.
    fit : bool array (K,)
        The joints that make up a pose: alignments are fitted to them, scored or not.
    body : bool array (K,)
        Those that are scored: the same, without the root where that is dropped.

    Raises
    ------
    PoseDataError
        Where no joint is left.
    """

    protocol: Protocol
    spec: DataSpec
    fit: BoolArray = field(init=False)
    body: BoolArray = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "fit", self._mask("joints", self.protocol.joints))
        object.__setattr__(self, "body", self.fit if self.protocol.root == "count" else self.moving)
        for option, mask in (
            ("joints", self.body),
            ("joints without the root", self.moving),
            ("pck_joints", self.pck),
            ("cps_joints", self.cps),
        ):
            if not mask.any():
                raise PoseDataError(f"{option}: none is left; the poses have {', '.join(self.spec.joints)}.")

    def _mask(self, option: str, text: str) -> BoolArray:
        names = named_joints(option, text, self.spec.joints)
        return np.array([name in names for name in self.spec.joints])

    @cached_property
    def moving(self) -> BoolArray:
        """The joints of a pose without the root."""
        mask = self.fit.copy()
        if self.spec.root is not None:
            mask[self.spec.root] = False
        return mask

    @cached_property
    def pck(self) -> BoolArray:
        """The joints of PCK and AUC."""
        text = self.protocol.pck_joints
        if text == Protocol().pck_joints and not set(JOINT_SETS[text]) & set(self.spec.joints):
            text = "all"  # joints that are not a person's, or have no names
        return self._mask("pck_joints", text) & self.body

    @cached_property
    def cps(self) -> BoolArray:
        """The joints of CPS."""
        return self._mask("cps_joints", self.protocol.cps_joints) & self.body

    def counted(self, mask: BoolArray) -> str:
        """Words for the scored ones of a mask of joints, with an article."""
        return f"the {self.number(mask)}"

    def number(self, mask: BoolArray) -> str:
        """Words for the scored ones of a mask of joints: of which, how many, and whether the root is one."""
        return self.size(mask) if self.protocol.where == "all" else f"{self.protocol.where} ones of {self.size(mask)}"

    def size(self, mask: BoolArray) -> str:
        """Words for a mask of joints, scored or not: how many, and whether the root is one."""
        words = f"{mask.sum()} joint{'s' if mask.sum() > 1 else ''}"
        root = self.spec.root
        if root is None:
            return words
        return f"{words} (root counted)" if mask[root] else f"{words} (no root)"
