"""Every registered number is what its name says, under every option that changes it.

Compared with :mod:`tests.helpers.naive_registry`. A metric that is registered without a twin fails the first test.
"""

from __future__ import annotations

import math
from functools import cache

import numpy as np
import numpy.typing as npt
import pytest

from posecal.engine.protocol import Protocol
from posecal.metrics.occlusion import occlusion_metrics_of
from posecal.registry import known_metrics
from tests.helpers.naive_registry import Twin
from tests.helpers.random_worlds import World, world
from tests.helpers.sums import accumulate

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
    "segments": Protocol(segment="3", where="visible"),
    "failures": Protocol(failure_threshold=80.0, single_pose="median_pose"),
    "failures-of-mode": Protocol(failure_threshold=130.0, single_pose="mode"),
}


@cache
def subject_of(name: str) -> World:
    """Worlds of even and odd N, with and without a mask, relative to the hip or as given."""
    number = list(PROTOCOLS).index(name)
    some = world(number, N=5 + number % 2, M=12)
    where = None
    if number % 3 == 2:
        where = np.random.default_rng(number).random(some.y.shape[:2]) < 0.85
        where[:, some.joints.index("Hip")] = True  # poses without the root are left out
        where[4] = False
    return World(**{**vars(some), "where": where, "root_joint": "none" if number % 5 == 4 else None})


@cache
def twin(name: str) -> Twin:
    return Twin(subject_of(name), PROTOCOLS[name])


@cache
def measured(name: str) -> tuple[dict[str, float], dict[str, Joints]]:
    totals = subject_of(name).totals(PROTOCOLS[name])
    metrics = known_metrics(PROTOCOLS[name], totals.spec)
    joints = {key: totals.by_joint(metric) for key, metric in metrics.items() if metric.by_joint is not None}
    return {key: totals.value(metric) for key, metric in metrics.items()}, joints


TOLERANCE = 1e-7
"""Rotations that nearly tie cost 1e-8 (:mod:`tests.geometry.test_procrustes`); all else is right to rounding."""

SINGLE = {"spread_error_correlation": 1e-6, "ause": 1e-6}
"""The values of all poses are kept in single precision."""


def test_every_registered_metric_has_a_twin() -> None:
    registered = known_metrics(Protocol(), world().spec)
    assert set(twin("defaults").numbers) == set(registered)
    assert set(twin("defaults").by_joint) == {name for name, metric in registered.items() if metric.by_joint}


MASKED_OR_SLOW = [
    pytest.param(name, marks=[] if number % 3 == 2 or not number else pytest.mark.slow)
    for number, name in enumerate(PROTOCOLS)
]
"""The defaults and the protocols whose worlds have a mask are quick, all together are not."""


@pytest.mark.parametrize("protocol", MASKED_OR_SLOW)
def test_registered_numbers_are_what_the_naive_formulas_give(protocol: str) -> None:
    found = measured(protocol)[0]
    assert set(found) == set(twin(protocol).numbers)
    for name, value in found.items():
        rtol = SINGLE.get(name, TOLERANCE)
        np.testing.assert_allclose(value, twin(protocol).value(name), rtol=rtol, atol=1e-9, err_msg=name)


@pytest.mark.parametrize("protocol", MASKED_OR_SLOW)
def test_numbers_per_joint_are_what_the_naive_formulas_give(protocol: str) -> None:
    found = measured(protocol)[1]
    assert set(found) == set(twin(protocol).by_joint)
    for name, values in found.items():
        np.testing.assert_allclose(values, twin(protocol).joint_values(name), rtol=TOLERANCE, atol=1e-9, err_msg=name)


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_every_number_of_a_pose_world_is_a_number(protocol: str) -> None:
    numbers = measured(protocol)[0]
    lacking = [name for name, value in numbers.items() if math.isnan(value)]
    lacking = [name for name in lacking if name not in {"coverage_90", "coverage_95"}]  # of few hypotheses
    if numbers["failure_rate"] in {0, 1} and not protocol.startswith("failures"):
        lacking.remove("failure_auroc")  # nothing to tell apart
    if PROTOCOLS[protocol].where != "all":  # a joint is seldom occluded, or visible, in three or four frames in a row
        lacking = [name for name in lacking if "jitter" not in name and "acceleration" not in name]
    assert not lacking


NAMES_NO_JOINTS = [name for name in PROTOCOLS if name != "other-joints"]


@pytest.mark.parametrize("protocol", NAMES_NO_JOINTS)
def test_a_number_that_an_option_changes_has_another_definition(protocol: str) -> None:
    """Of joints, definitions say only how many they are; the signature names them."""
    some = subject_of("defaults")
    usual, changed = known_metrics(Protocol(), some.spec), known_metrics(PROTOCOLS[protocol], some.spec)
    before, after = measured("defaults")[0], some.values(PROTOCOLS[protocol])
    before = {name: value for name, value in before.items() if name in after}  # a hand has no limbs of a person
    known = [name for name in before if not math.isnan(before[name])]
    other = [name for name in known if not math.isclose(before[name], after[name], rel_tol=1e-9)]
    assert not [name for name in other if usual[name].definition == changed[name].definition]


@pytest.mark.parametrize("occlusion", ["occluded", "visible"])
@pytest.mark.parametrize("protocol", ["defaults", "some-joints", "occluded", "rms-mean"])
def test_numbers_over_occluded_and_visible_joints_are_what_the_naive_formulas_give(
    protocol: str, occlusion: str
) -> None:
    totals = accumulate(subject_of(protocol).pairs, PROTOCOLS[protocol], by=["occlusion"])
    metrics = occlusion_metrics_of(PROTOCOLS[protocol], totals.spec)[occlusion]
    found = {name: totals.value(metric) for name, metric in metrics.items()}
    expected = twin(protocol).by_occlusion(occlusion)
    assert set(found) == set(expected)
    for name, value in found.items():
        np.testing.assert_allclose(value, expected[name], rtol=TOLERANCE, atol=1e-9, err_msg=name)
