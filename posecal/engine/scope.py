"""What definitions of metrics depend on: the data, and the joints that each kind of metric is about."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from functools import cached_property

import numpy as np

from posecal.data.arrays import BoolArray
from posecal.data.joint_names import MOST_NAMED, joint_keys
from posecal.data.pose_data import PoseData
from posecal.data.root import AnyRoot, Root, resting_joints
from posecal.data.skeleton import JOINT_SETS, known_set
from posecal.data.units import PERIODS
from posecal.data.weights import are_unequal
from posecal.engine.protocol import Protocol, named_joints
from posecal.errors import PoseDataError, first_few
from posecal.errors import option as named
from posecal.geometry.procrustes import FEWEST_JOINTS

MESHES = (6890, 10475, 778)
"""How many vertices the meshes of SMPL, SMPL-X and MANO have."""


@dataclass(frozen=True)
class DataSpec:
    """Everything about the data that a definition depends on.

    Attributes
    ----------
    n_hypotheses : int
        N.
    joints : tuple of str
        K names.
    root : int, Root or None
        What is subtracted from every pose.
    parents : tuple of int
        The user's own skeleton; empty where it follows from the names.
    labels : tuple of str
        Names of the labels that every pose has.
    fps : float or None
        Frames per second.
    has_scores : bool
        Whether the model gives a score for each hypothesis.
    dimensions : int
        The number of coordinates that the model's log densities are over; 0 where it gives none.
    has_occlusion : bool
        Whether occluded joints are marked.
    has_mask : bool
        Whether joints of some poses are left out by the user's mask.
    preranks : tuple of str
        Names of the user's own pre-ranks.
    reference : str
        What skill scores are relative to; empty without skill scores.
    n_reference : int
        Its number of hypotheses.
    unit : str
        ``mm``, ``deg``, ``px``, or empty.
    n_coordinates : int
        D.
    is_ragged : bool
        Whether hypotheses of some poses are absent; N is the most that a pose has.
    has_weights : bool
        Whether hypotheses of a pose have unequal weights.
    apart : tuple of str
        Of merged results: what each had found from its own poses alone, such as the ``coordinate range``.
    clip_length : int
        T, the number of frames of a clip; 0 where poses form no clips.
    has_clip_numbers : bool
        Whether sequences are the numbers of clips, which have no names.
    has_observed : bool
        Whether the last observed pose before each clip is known.
    n_effective : float or None
        Mean effective number of hypotheses, once it is measured, where poses have different ones.
    """

    n_hypotheses: int
    joints: tuple[str, ...]
    root: AnyRoot = None
    labels: tuple[str, ...] = ()
    fps: float | None = None
    has_scores: bool = False
    has_occlusion: bool = False
    has_mask: bool = False
    preranks: tuple[str, ...] = ()
    reference: str = ""
    n_reference: int = 0
    unit: str = "mm"
    n_coordinates: int = 3
    is_ragged: bool = False
    has_weights: bool = False
    parents: tuple[int, ...] = ()
    dimensions: int = 0
    apart: tuple[str, ...] = ()
    clip_length: int = 0
    has_clip_numbers: bool = False
    has_observed: bool = False
    n_effective: float | None = None

    def __post_init__(self) -> None:
        root: object = self.root
        if isinstance(root, Mapping):  # as JSON has it
            object.__setattr__(self, "root", Root(**root))

    @classmethod
    def of(
        cls, data: PoseData, *, has_mask: bool = False, preranks: tuple[str, ...] = (), is_ragged: bool = False
    ) -> DataSpec:
        """Describe pose data."""
        return cls(
            n_hypotheses=data.shape[0],
            joints=data.joints,
            root=data.root,
            parents=data.parents,
            unit=data.unit,
            n_coordinates=data.shape[3],
            labels=tuple(data.labels),
            clip_length=0 if data.clips is None else data.clips.length,
            has_clip_numbers=data.clips is not None and "sequence" in data.clips.numbered,
            has_observed=data.clips is not None and bool(data.clips.observed),
            fps=data.fps,
            has_scores=data.scores is not None,
            dimensions=data.dimensions,
            has_occlusion=data.occluded is not None,
            has_mask=has_mask,
            preranks=preranks,
            is_ragged=is_ragged,
            has_weights=data.weights is not None and bool(are_unequal(data.weights).any()),
            reference="" if data.reference is None else data.reference.names[0],
            n_reference=0 if data.reference is None else data.reference.shape[0],
        )

    @property
    def n_in_balls(self) -> float:
        """How many hypotheses a pose has on average, by which balls of a level are known or not."""
        return self.n_hypotheses if self.n_effective is None else self.n_effective

    @property
    def period(self) -> float | None:
        """After how much coordinates repeat; None where they don't."""
        return PERIODS.get(self.unit)

    @property
    def is_mesh(self) -> bool:
        """Whether the joints are the vertices of a mesh."""
        return len(self.joints) in MESHES

    @property
    def point(self) -> tuple[str, str]:
        """What a joint is called: one, and several."""
        return ("vertex", "vertices") if self.is_mesh else ("joint", "joints")

    def together_with(self, other: DataSpec) -> DataSpec:
        """Describe these poses and others together, where some of either lack hypotheses, or have weights."""
        return replace(
            self,
            is_ragged=self.is_ragged or other.is_ragged,
            has_weights=self.has_weights or other.has_weights,
        )

    def difference(self, other: DataSpec) -> str:
        """Say in what these data differ from others."""
        pairs = ((f.name, getattr(self, f.name), getattr(other, f.name)) for f in fields(self))
        return "; ".join(f"{name} {mine!r} against {theirs!r}" for name, mine, theirs in pairs if mine != theirs)


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
        ):
            if not mask.any():
                positions = f" Of positions as they are, pass {named('root_joint', 'none')}." if self.fit.any() else ""
                joints = first_few(self.spec.joints, MOST_NAMED)
                raise PoseDataError(f"{option}: none is left; the poses have {joints}.{positions}")

    def _mask(self, option: str, text: str) -> BoolArray:
        names = frozenset(named_joints(option, text, self.spec.joints))
        return np.array([name in names for name in self.spec.joints])

    @cached_property
    def moving(self) -> BoolArray:
        """The joints of a pose without the root."""
        mask = self.fit.copy()
        mask[resting_joints(self.spec.root)] = False
        return mask

    @cached_property
    def is_whole(self) -> bool:
        """Whether all joints are scored, but for the root."""
        number = len(self.spec.joints) - len(resting_joints(self.spec.root))
        return self.protocol.where == "all" and int(self.moving.sum()) == number

    @cached_property
    def pck(self) -> BoolArray:
        """The joints of PCK and AUC."""
        text, found = self.protocol.pck_joints, known_set(self.spec.joints)
        is_person = {*JOINT_SETS["h36m-14"]} & {*joint_keys(self.spec.joints)} and not (found and found.rest)
        if text == Protocol().pck_joints and not is_person:
            text = "all"  # joints that are not a person's, or have no names
        return self._mask("pck_joints", text) & self.body

    @cached_property
    def cps(self) -> BoolArray:
        """The joints of CPS."""
        return self._mask("cps_joints", self.protocol.cps_joints) & self.body

    def fewest_to_align(self, name: str) -> int:
        """Give how many joints a metric needs at least, by its name; of fewer all aligned poses are perfect."""
        p = self.protocol
        align = p.align if name.startswith("pa_") else p.cps_align if "cps" in name else "none"
        return FEWEST_JOINTS.get(align, 0)

    def lack(self, name: str) -> str:
        """Say which joints a metric lacks: those of PCK and AUC, of CPS, or of an alignment; nothing for others."""
        if self.fit.sum() < (least := self.fewest_to_align(name)):
            return f"at least {least} joints to align"
        kind = "pck" if "pck" in name or "auc" in name else "cps" if "cps" in name else ""
        if not kind or getattr(self, kind).any():
            return ""
        return f"joints to score: none of {kind}_joints = {getattr(self.protocol, f'{kind}_joints')} is"

    def counted(self, mask: BoolArray) -> str:
        """Words for the scored ones of a mask of joints, with an article."""
        return f"the {self.number(mask)}"

    def named(self, mask: BoolArray) -> str:
        """Words for the scored ones of a mask of joints, with their names where those are not Human3.6M's."""
        joints = self.spec.joints
        if len(joints) > MOST_NAMED or {*joint_keys(joints)} <= {*JOINT_SETS["h36m-17"]} or mask.all():
            return self.counted(mask)
        names = [name for name, chosen in zip(joints, mask, strict=True) if chosen]
        return f"{self.counted(mask)}, {', '.join(names)},"

    def number(self, mask: BoolArray) -> str:
        """Words for the scored ones of a mask of joints: of which, how many, and whether the root is one."""
        return self.size(mask) if self.protocol.where == "all" else f"{self.protocol.where} ones of {self.size(mask)}"

    def size(self, mask: BoolArray) -> str:
        """Words for a mask of joints, scored or not: how many, and whether the root is one."""
        words = f"{mask.sum()} {self.spec.point[int(mask.sum() > 1)]}"
        resting = resting_joints(self.spec.root)
        if not resting:
            return words
        return f"{words} (root counted)" if mask[resting].any() else f"{words} (no root)"
