"""Random poses for tests: skewed, with every axis of another length and no zeros but those of the root."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import numpy.typing as npt

from posecal.data.pose_data import PoseData
from posecal.engine.protocol import Protocol
from posecal.engine.scope import DataSpec
from posecal.engine.totals import Totals
from posecal.evaluation import evaluate
from posecal.registry import known_metrics

JOINTS = ("Spine", "RKnee", "Hip", "LFoot", "Head", "LWrist", "Neck/Nose", "RElbow")
"""Of which Spine is no joint of CPS; Spine, Hip and Neck/Nose are none of PCK."""

Array = npt.NDArray[np.floating]
Mask = npt.NDArray[np.bool_]


def skewed(seed: int, N: int, M: int, K: int, D: int = 3) -> tuple[Array, Array]:
    """Hypotheses (N, M, K, D) and truth (M, K, D), mm: biased, skewed, a width of its own per joint and axis."""
    random = np.random.default_rng(seed)
    y = random.normal(40, 300, (M, K, D))
    widths = random.uniform(20, 90, (K, D))
    x = y + widths * (random.gamma(2.0, 1.0, (N, M, K, D)) - 1.7)
    x += random.normal(0, 30, (M, K, D))
    return x, y


def mostly(M: int, K: int) -> Mask:
    """Joints that count, (M, K): seven of ten; in pose 4, none."""
    mask = np.random.default_rng(1).random((M, K)) < 0.7
    mask[4] = False
    return mask


@dataclass(frozen=True)
class World:
    """Poses of people with everything that can be said of them."""

    x: Array
    y: Array
    sequence: npt.NDArray[np.str_]
    action: npt.NDArray[np.str_]
    occluded: npt.NDArray[np.bool_]
    scores: Array
    joints: tuple[str, ...] = JOINTS
    fps: float = 25.0
    where: npt.NDArray[np.bool_] | None = None
    root_joint: str | None = None

    @property
    def pairs(self) -> PoseData:
        """As somebody would pass them."""
        return PoseData(
            self.x,
            self.y,
            where=self.where,
            joints=self.joints,
            root_joint=self.root_joint,
            labels={"sequence": self.sequence, "action": self.action},
            occluded=self.occluded,
            scores=self.scores,
            fps=self.fps,
            unit="mm",
            axes="NMKD",
        )

    @cached_property
    def root(self) -> int | None:
        """The joint that is subtracted."""
        return None if self.root_joint == "none" else self.joints.index("Hip")

    @property
    def spec(self) -> DataSpec:
        """What is measured."""
        return DataSpec(len(self.x), self.joints, self.root, ("sequence", "action"), self.fps, True, True)

    def totals(self, protocol: Protocol, *, threads: int = 1) -> Totals:
        """The sums of every metric that is known."""
        return evaluate(self.pairs, protocol=replace(protocol, metrics="all"), by="action", threads=threads).totals

    def values(self, protocol: Protocol, *, threads: int = 1) -> dict[str, float]:
        """Every metric that is known."""
        totals = self.totals(protocol, threads=threads)
        return {name: totals.value(metric) for name, metric in known_metrics(protocol, totals.spec).items()}

    def select(self, poses: npt.NDArray[np.intp]) -> World:
        """Some of the poses, by their numbers."""
        return replace(
            self,
            x=self.x[:, poses],
            y=self.y[poses],
            sequence=self.sequence[poses],
            action=self.action[poses],
            occluded=self.occluded[poses],
            scores=self.scores[:, poses],
            where=None if self.where is None else self.where[poses],
        )


def world(seed: int = 0, N: int = 5, M: int = 10, *, dtype: str = "f8") -> World:
    """M poses of five uneven sequences, of which two share an action; each frame has joints that nobody saw."""
    random = np.random.default_rng([seed, 1])
    x, y = skewed(seed, N, M, len(JOINTS))
    lengths = np.diff(np.round(M * np.array([0, 0.15, 0.4, 0.5, 0.85, 1])).astype(int))
    return World(
        x=x.astype(dtype),
        y=y.astype(dtype),
        sequence=np.repeat(["S9/a", "S9/b", "S11/a", "S11/b", "S11/c"], lengths),
        action=np.repeat(["walk", "sit", "walk", "sit", "eat"], lengths),
        occluded=random.random(y.shape[:2]) < 0.4,
        scores=random.gamma(1.5, 1.0, (N, M)),
    )
