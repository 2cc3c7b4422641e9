"""Is every registered number what its name says, under every option that changes it?

The whole registry once more, made of the naive twins of :mod:`tests.oracles`. A metric that is registered without a
twin here fails the first test.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache

import numpy as np
import numpy.typing as npt
import pytest

from posecal.protocol import Protocol
from posecal.registry import known_metrics
from posecal.skeleton import JOINT_SETS
from tests import oracles
from tests.drawn import JOINTS, World, world

Poses = npt.NDArray[np.intp]
Numbers = dict[str, Callable[[Poses], float]]
Joints = npt.NDArray[np.float64]

HAND = "Hip, Head, LWrist, RElbow"

PROTOCOLS = {
    "defaults": Protocol(),
    "root-dropped": Protocol(root="drop"),
    "some-joints": Protocol(joints=HAND),
    "joint-set": Protocol(joints="h36m-16", pck_joints="all", cps_joints="all"),
    "other-joints": Protocol(pck_joints="Head, RKnee, Hip", cps_joints="all but Head"),
    "occluded": Protocol(where="occluded"),
    "occluded-mean": Protocol(where="occluded", ece_over="mean", root="drop"),
    "visible-median": Protocol(where="visible", ece_over="median"),
    "worst-joint": Protocol(ece_over="worst"),
    "pooled": Protocol(ece_over="pooled"),
    "sequence-best": Protocol(best="sequence"),
    "batch-best": Protocol(best="batch:2"),
    "batch-best-occluded": Protocol(best="batch:3", where="occluded", joints=HAND),
    "joint-best": Protocol(best="joint"),
    "joint-best-visible": Protocol(best="joint", where="visible", root="drop"),
    "rigid": Protocol(align="rigid"),
    "reflection": Protocol(align="reflection"),
    "linked": Protocol(align_best="linked", pck_best="linked", cps_best="linked"),
    "linked-rigid-occluded": Protocol(align_best="linked", align="rigid", where="occluded", pck_best="linked"),
    "mean-over-hypotheses": Protocol(pck_best="mean", cps_best="mean"),
    "norm-root": Protocol(scale="norm_root"),
    "rms-mean": Protocol(scale="rms_mean", where="visible"),
    "indexed-mode": Protocol(mode="3"),
    "at-threshold": Protocol(pck_rule="<=", pck_threshold=80.0),
    "integral": Protocol(auc="integral", pck_best="mean"),
    "integral-of-best": Protocol(auc="integral", where="visible"),
    "integral-linked": Protocol(auc="integral", pck_best="linked"),
    "unaligned-cps": Protocol(cps_align="none", cps_unit="share"),
    "cps-linked-unaligned": Protocol(cps_align="none", cps_best="linked", where="visible"),
    "per-second": Protocol(velocity="second", where="visible"),
    "population": Protocol(deviation="population"),
    "by-action": Protocol(average="action"),
    "by-sequence": Protocol(average="sequence", where="occluded", best="sequence"),
    "batches-by-action": Protocol(average="action", best="batch:2"),
}


@cache
def subject_of(name: str) -> World:
    """Worlds of even and odd N, with and without a mask, relative to the hip or as given."""
    number = list(PROTOCOLS).index(name)
    some = world(number, N=5 + number % 2)
    where = None
    if number % 3 == 2:
        where = np.random.default_rng(number).random(some.y.shape[:2]) < 0.8
        where[4] = False
    return World(**{**vars(some), "where": where, "root_joint": "none" if number % 5 == 4 else None})


def mean_known(values: npt.NDArray[np.float64]) -> float:
    """Mean of what is not NaN."""
    return oracles.mean([float(v) for v in values if not math.isnan(v)])


class Twin:
    """Every number of a world under a protocol, by the naive formulas."""

    def __init__(self, some: World, protocol: Protocol) -> None:
        self.world, self.protocol = some, protocol
        self.x, self.y = oracles.relative(some.x, some.root), oracles.relative(some.y, some.root)
        self.counted = np.ones(some.y.shape[:2], dtype=bool) if some.where is None else some.where
        if protocol.where == "occluded":
            self.counted = self.counted & some.occluded
        if protocol.where == "visible":
            self.counted = self.counted & ~some.occluded
        body = self.joints(protocol.joints)
        if protocol.root == "drop" and some.root is not None:
            body[some.root] = False
        moving = body.copy()
        if some.root is not None:
            moving[some.root] = False
        self.body, self.moving = self.counted & body, self.counted & moving
        self.pck_joints = self.body & self.joints(protocol.pck_joints)
        self.cps_joints = self.body & self.joints(protocol.cps_joints)
        self.errors = oracles.pose_errors(self.x, self.y, self.body)
        self.links = oracles.links(self.errors)
        self.numbers: Numbers = {}
        self.by_joint: dict[str, Callable[[Poses], Joints]] = {}
        self.define()

    def joints(self, text: str) -> npt.NDArray[np.bool_]:
        if text.startswith("all but "):
            return np.array([name != text.removeprefix("all but ") for name in JOINTS])
        names = JOINTS if text == "all" else JOINT_SETS.get(text, tuple(text.split(", ")))
        return np.array([name in names for name in JOINTS])

    def value(self, name: str) -> float:
        """The number over all poses, or the mean over the groups that the protocol averages."""
        label = self.protocol.average
        if label == "poses":
            return self.numbers[name](np.arange(len(self.y)))
        groups = getattr(self.world, label)
        return mean_known(np.array([self.numbers[name](np.flatnonzero(groups == g)) for g in np.unique(groups)]))

    def joint_values(self, name: str) -> Joints:
        """The same for each joint."""
        label, of = self.protocol.average, self.by_joint[name]
        if label == "poses":
            return of(np.arange(len(self.y)))
        groups = getattr(self.world, label)
        values = np.array([of(np.flatnonzero(groups == g)) for g in np.unique(groups)])
        return np.array([mean_known(column) for column in values.T])

    def over_poses(self, name: str, values: npt.NDArray[np.float64], factor: float = 1.0) -> None:
        self.numbers[name] = lambda poses: factor * mean_known(values[poses])

    def define(self) -> None:
        p = self.protocol
        for prefix, align in (("", "none"), ("pa_", p.align), ("n_", p.scale)):
            self.define_errors(prefix, align)
        for n in (1, 2, 5):
            subsets = [oracles.best_of_subsets(list(e), n) for e in self.errors.T]
            self.over_poses(f"min_mpjpe_at_{n}", np.array(subsets))
        self.define_shares()
        factor = self.world.fps if p.velocity == "second" else 1.0
        for name, x in (("mpjve", self.x), ("mean_pose_mpjve", oracles.one_pose(self.x, "mean_pose"))):
            steps = oracles.velocity_errors(x, self.y, self.body, list(self.world.sequence))
            self.over_poses(name, steps, factor)
        self.define_calibration()
        less = 0 if p.deviation == "population" else 1
        self.define_spread("diversity", oracles.deviations(self.x, less))
        for share in (50, 90):
            self.define_spread(f"radius_{share}", oracles.radii(self.x, share / 100))

    def define_errors(self, prefix: str, align: str) -> None:
        p, names = self.protocol, self.world.sequence
        x = oracles.aligned(self.x, self.y, self.body, align)
        e = oracles.pose_errors(x, self.y, self.body)
        kind, _, clips = p.best.partition(":")
        if kind == "joint":
            self.over_poses(f"{prefix}min_mpjpe", oracles.best_per_joint(x, self.y, self.body))
        elif kind != "frame":
            self.numbers[f"{prefix}min_mpjpe"] = lambda poses: oracles.best_per_batch(
                e[:, poses], list(names[poses]), int(clips or 1)
            )
        elif prefix == "pa_" and p.align_best == "linked":
            self.over_poses("pa_min_mpjpe", np.array([e[n, m] for m, n in enumerate(self.links)]))
        else:
            self.numbers[f"{prefix}min_mpjpe"] = lambda poses: oracles.best_per_frame(e[:, poses])
        for of, name in (("mean", "mpjpe"), ("median", "median_mpjpe"), ("worst", "worst_mpjpe")):
            self.over_poses(prefix + name, np.array([oracles.of_errors(list(column), of) for column in e.T]))
        index = None if p.mode == "score" else int(p.mode)
        for of in ("mean_pose", "median_pose", "weighted_pose", "mode"):
            pose = oracles.one_pose(self.x, of, self.world.scores, index if of == "mode" else None)
            moved = oracles.aligned(pose, self.y, self.body, align)
            self.over_poses(f"{prefix}{of}_mpjpe", oracles.pose_errors(moved, self.y, self.body)[0])
        if not prefix:
            d = oracles.joint_errors(x, self.y)
            chosen = np.array([d[n, m] for m, n in enumerate(self.links)])
            self.over_joints("mpjpe", d.mean(axis=0), self.body)
            if kind in {"frame", "joint"}:
                self.over_joints("min_mpjpe", chosen if kind == "frame" else d.min(axis=0), self.body)

    def define_shares(self) -> None:
        p = self.protocol
        d, strict = oracles.joint_errors(self.x, self.y), p.pck_rule == "<"
        self.over_poses("pck", oracles.pck(d, self.pck_joints, p.pck_threshold, p.pck_best, self.links, strict=strict))
        if p.auc == "integral":
            self.over_poses("auc", oracles.auc_integral(d, self.pck_joints, p.pck_best, self.links))
        else:
            self.over_poses("auc", oracles.auc(d, self.pck_joints, p.pck_best, self.links, strict=strict))
        d = oracles.joint_errors(oracles.aligned(self.x, self.y, self.body, p.cps_align), self.y)
        area = oracles.cps(d, self.cps_joints, p.cps_best, self.links)
        self.over_poses("cps", area, 1 / 300 if p.cps_unit == "share" else 1.0)

    def define_calibration(self) -> None:
        over = self.protocol.ece_over
        if over == "auto":
            over = "median" if self.protocol.where == "all" else "pooled"
        for definition, suffix in (("exchangeable", ""), ("paper", "_paper"), ("reference", "_reference")):
            weights = oracles.inside(self.x, self.y, self.moving, definition)
            for ending, how in (("", over), ("_mean", "mean"), ("_worst", "worst")):
                self.numbers[f"ece{suffix}{ending}"] = lambda poses, weights=weights, how=how: oracles.ece(
                    oracles.curves(weights[poses]), oracles.pooled_curve(weights[poses]), how
                )
            self.by_joint[f"ece{suffix}"] = lambda poses, weights=weights: np.array(
                [oracles.curve_ece(curve) for curve in oracles.curves(weights[poses])]
            )
            if definition == "exchangeable":
                self.define_exchangeable(weights, over)

    def define_exchangeable(self, weights: npt.NDArray[np.float64], over: str) -> None:
        def summary(poses: Poses) -> npt.NDArray[np.float64]:
            return oracles.over_joints(oracles.curves(weights[poses]), oracles.pooled_curve(weights[poses]), over)

        def areas(poses: Poses) -> list[float]:
            found = [oracles.curve_area(curve) for curve in oracles.curves(weights[poses])]
            return [area for area in found if not math.isnan(area)] or [math.nan]

        self.numbers["signed_area"] = lambda poses: oracles.curve_area(summary(poses))
        self.numbers["signed_area_min"] = lambda poses: min(areas(poses))
        self.numbers["signed_area_max"] = lambda poses: max(areas(poses))
        self.by_joint["signed_area"] = lambda poses: np.array(
            [oracles.curve_area(curve) for curve in oracles.curves(weights[poses])]
        )
        for percent, level in ((50, 10), (80, 16), (90, 18), (95, 19)):
            self.numbers[f"coverage_{percent}"] = lambda poses, level=level: float(summary(poses)[level])
            self.by_joint[f"coverage_{percent}"] = lambda poses, level=level: oracles.curves(weights[poses])[:, level]

    def define_spread(self, name: str, values: npt.NDArray[np.float64]) -> None:
        self.over_joints(name, values, self.moving)
        self.numbers[name] = lambda poses: mean_known(self.by_joint[name](poses))

    def over_joints(self, name: str, values: npt.NDArray[np.float64], counted: npt.NDArray[np.bool_]) -> None:
        def means(poses: Poses) -> Joints:
            columns = zip(values[poses].T, counted[poses].T, strict=True)
            return np.array([oracles.mean(list(column[kept])) for column, kept in columns])

        self.by_joint[name] = means


@cache
def twin(name: str) -> Twin:
    return Twin(subject_of(name), PROTOCOLS[name])


@cache
def measured(name: str) -> tuple[dict[str, float], dict[str, Joints]]:
    totals = subject_of(name).totals(PROTOCOLS[name])
    metrics = known_metrics(PROTOCOLS[name], totals.subject)
    joints = {key: totals.by_joint(metric) for key, metric in metrics.items() if metric.by_joint is not None}
    return {key: totals.value(metric) for key, metric in metrics.items()}, joints


TOLERANCE = 1e-7
"""Rotations that nearly tie cost 1e-8 (:mod:`tests.test_align`); all else is right to rounding."""


def test_every_registered_metric_has_a_twin() -> None:
    registered = known_metrics(Protocol(), world().subject)
    assert set(twin("defaults").numbers) == set(registered)
    assert set(twin("defaults").by_joint) == {name for name, metric in registered.items() if metric.by_joint}


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_registered_numbers_are_what_the_naive_formulas_give(protocol: str) -> None:
    found = measured(protocol)[0]
    assert set(found) == set(twin(protocol).numbers)
    for name, value in found.items():
        np.testing.assert_allclose(value, twin(protocol).value(name), rtol=TOLERANCE, atol=1e-9, err_msg=name)


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_numbers_per_joint_are_what_the_naive_formulas_give(protocol: str) -> None:
    found = measured(protocol)[1]
    assert set(found) == set(twin(protocol).by_joint)
    for name, values in found.items():
        np.testing.assert_allclose(values, twin(protocol).joint_values(name), rtol=TOLERANCE, atol=1e-9, err_msg=name)


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_every_number_of_a_pose_world_is_a_number(protocol: str) -> None:
    assert not [name for name, value in measured(protocol)[0].items() if math.isnan(value)]


NAMES_NO_JOINTS = [name for name in PROTOCOLS if name != "other-joints"]


@pytest.mark.parametrize("protocol", NAMES_NO_JOINTS)
def test_a_number_that_an_option_changes_has_another_definition(protocol: str) -> None:
    """Of joints, definitions say only how many they are; the signature names them."""
    some = subject_of("defaults")
    usual, changed = known_metrics(Protocol(), some.subject), known_metrics(PROTOCOLS[protocol], some.subject)
    before, after = measured("defaults")[0], some.values(PROTOCOLS[protocol])
    for name in before:
        if not math.isclose(before[name], after[name], rel_tol=1e-9):
            assert usual[name].definition != changed[name].definition
