"""Metrics are finished for many means at once, and say which tables show them."""

from __future__ import annotations

import warnings
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from posecal.calibration import LEVELS
from posecal.data.skeleton import JOINT_SETS
from posecal.engine.block import Block
from posecal.engine.metric import Metric, Statistic
from posecal.engine.protocol import Protocol
from posecal.engine.scope import DataSpec
from posecal.errors import PoseDataError
from posecal.registry import (
    any_metrics,
    curves_of,
    known_metrics,
    left_out,
    metrics_of,
    occlusion_metrics_of,
)
from posecal.report.table import auxiliary_rows
from posecal.stats.resampling import sign_flips

Array = np.ndarray
H36M = JOINT_SETS["h36m-17"]
PERSON = DataSpec(7, H36M, 0, ("sequence",), 25.0, True)


# --- many means at once ----------------------------------------------------------------------------------------------

EVERYTHING = replace(PERSON, has_occlusion=True, preranks=("height",), reference="climatology", n_reference=6)
EVERYTHING = replace(EVERYTHING, dimensions=48)
PROTOCOLS = {
    "default": Protocol(),
    "occluded": Protocol(where="occluded", root="drop", cps_unit="share", velocity="second"),
    "mean": Protocol(ece_over="mean", best="joint", mode="2"),
    "worst": Protocol(ece_over="worst", best="sequence"),
    "pooled": Protocol(ece_over="pooled", best="batch:2", auc="integral"),
}


@cache
def metrics_and_means(protocol: str) -> list[tuple[Metric, dict[str, Array]]]:
    """Every metric, over occluded and visible joints too, with the mean of each of its statistics over four poses."""
    random = np.random.default_rng(0)
    y = random.normal(0, 300, (4, 17, 3))
    x, reference = y + random.normal(0, 60, (7, 4, 17, 3)), y + random.normal(0, 90, (6, 4, 17, 3))
    occluded, scores = random.random((4, 17)) < 0.4, random.random((7, 4))
    follows = np.array([False, True, True, True])
    log_prob = random.normal(-200, 9, 4)
    block = Block(
        x, y, root=0, scores=scores, log_prob=log_prob, occluded=occluded, reference=reference, follows=follows
    )
    preranks = {"height": lambda pool: pool[..., 2].max(axis=1)}
    own = Metric.from_function(lambda x, y: np.abs(x - y).mean(axis=(0, 3)), name="own", by_joint=True)
    metrics = [*known_metrics(PROTOCOLS[protocol], EVERYTHING, preranks, own=[own]).values()]
    metrics += [m for ms in occlusion_metrics_of(PROTOCOLS[protocol], EVERYTHING).values() for m in ms.values()]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # means of nothing, at the root
        means = {s.name: np.nanmean(s.compute(block), axis=0) for metric in metrics for s in metric.statistics}
    return [(metric, means) for metric in metrics if not metric.statistic.per_pose]


def stack(statistic: Statistic, mean: Array) -> Array:
    """Means like one mean, (2, 4, *shape); joints that don't count in all of them, in some, and once none that does."""
    random = np.random.default_rng(1)
    means = mean * random.uniform(0.6, 1.4, (2, 4, *mean.shape))
    if statistic.per_joint and mean.shape[0] > 3:
        means[:, :, 2] = np.nan
        means[0, 1:3, 3] = means[1, 3, 5:9] = np.nan
    means[1, 0] = np.nan
    return means


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_a_stack_of_means_is_finished_as_each_of_them_is(protocol: str) -> None:
    for metric, mean_of in metrics_and_means(protocol):
        means = stack(metric.statistic, mean_of[metric.statistic.name])
        numbers = np.asarray(metric.finish(means))
        assert numbers.shape == (2, 4), metric.name
        assert np.isnan(numbers[1, 0]), metric.name
        known = "NaN, since" not in metric.definition  # coverage of few hypotheses
        assert (np.isnan(np.delete(numbers.ravel(), 4)) != known).all(), metric.name
        for index in np.ndindex(2, 4):
            np.testing.assert_allclose(numbers[index], metric.finish(means[index]), rtol=1e-12, err_msg=metric.name)


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_a_stack_of_means_gives_each_joint_s_number_as_each_of_them_does(protocol: str) -> None:
    tried = []
    for metric, mean_of in metrics_and_means(protocol):
        if metric.by_joint is not None:
            statistic, of_joints = metric.by_joint
            means = stack(statistic, mean_of[statistic.name])
            numbers = np.asarray(of_joints(means))
            assert numbers.shape == (2, 4, 17), metric.name
            assert np.isnan(numbers[:, :, 2]).all(), metric.name
            known = "NaN, since" not in metric.definition
            assert (np.isnan(numbers[0, 0, 4:]) != known).all(), metric.name
            for index in np.ndindex(2, 4):
                np.testing.assert_allclose(numbers[index], of_joints(means[index]), rtol=1e-12, err_msg=metric.name)
            tried.append(metric.name)
    assert {"mpjpe", "ece", "ece_paper", "coverage_90", "coordinate_pit", "energy_score", "radius_90", "own"} <= {
        *tried
    }


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_no_label_reads_as_a_list_of_two(protocol: str) -> None:
    metrics = any_metrics(PROTOCOLS[protocol], EVERYTHING)
    labels = [entry.label for entry in (*metrics.values(), *auxiliary_rows(metrics).values())]
    assert len(labels) > 100
    assert len({*labels}) == len(labels)
    assert [label for label in labels if "," in label] == []


def test_an_order_over_poses_without_a_sequence_is_that_of_the_others() -> None:
    known = [metric for metric in known_metrics(Protocol(), EVERYTHING).values() if metric.statistic.per_pose]
    risk = ["aurc", "excess_aurc", "failure_auroc", "failure_rate"]
    assert [metric.name for metric in known] == ["spread_error_correlation", "ause", *risk]
    values, sequence = np.random.default_rng(3).gamma(2, 70, (30, 2)), np.arange(30) % 4
    for metric in known:
        assert metric.leave_out is not None
        expected = [metric.finish(values[sequence != s]) for s in range(4)]
        np.testing.assert_allclose(metric.leave_out(values, sequence), expected, rtol=1e-9, err_msg=metric.name)


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_what_sign_flips_test_is_the_number_that_is_reported(protocol: str) -> None:
    random, tested = np.random.default_rng(2), []
    for metric, mean_of in metrics_and_means(protocol):
        if metric.deviation is not None:
            table = random.random(mean_of[metric.statistic.name].shape)
            expected = LEVELS if metric.offset is None else LEVELS + metric.offset
            deviations = (table - expected).reshape(1, -1, LEVELS.size)
            counts = np.ones(deviations.shape[:2], dtype=int)
            observed = sign_flips(deviations, counts, metric.deviation, offset=metric.offset).observed
            np.testing.assert_allclose(observed, metric.finish(table), rtol=1e-5, err_msg=metric.name)
            tested.append(metric.name)
    assert {"ece", "ece_mean", "ece_worst", "ece_paper", "ece_reference_worst", "tarp", "coordinate_pit"} <= {*tested}
    assert tested.count("ece") == 3  # over all joints, over the occluded and over the visible ones


# --- what stands in which table --------------------------------------------------------------------------------------


def test_metrics_say_which_tables_show_them() -> None:
    known = known_metrics(Protocol(), replace(EVERYTHING, n_hypotheses=19))
    by_group = [name for name, metric in known.items() if metric.in_group_table]
    by_joint = [name for name, metric in known.items() if metric.in_joint_table]
    headlines = [name for name, metric in known.items() if metric.headline]
    assert headlines == [
        *("min_mpjpe", "mpjpe", "mean_pose_mpjpe", "pa_min_mpjpe", "pck", "auc", "cps", "ece", "ece_paper"),
        *("signed_area", "coverage_50", "coverage_80", "coverage_90", "coverage_95"),
        *("radius_50", "radius_90", "diversity", "spread_error_correlation"),
        *("nll", "nll_per_dimension", "log_likelihood_skill"),
    ]
    assert by_group == [
        "min_mpjpe",
        "mpjpe",
        "pa_min_mpjpe",
        "pck",
        "ece",
        "signed_area",
        "coverage_90",
        "radius_50",
        "nll",
    ]
    assert by_joint == [
        *("min_mpjpe", "mpjpe", "ece", "signed_area", "coverage_50", "coverage_90", "radius_50", "radius_90"),
    ]


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_only_metrics_with_a_number_per_joint_stand_in_the_table_of_joints(protocol: str) -> None:
    known = known_metrics(PROTOCOLS[protocol], EVERYTHING)
    assert not [name for name, metric in known.items() if metric.in_joint_table and metric.by_joint is None]
    occlusion = occlusion_metrics_of(PROTOCOLS[protocol], EVERYTHING)["visible"]
    assert all(metric.in_group_table and not metric.in_joint_table for metric in occlusion.values())


def test_metrics_without_joints_are_left_out_unless_they_are_asked_for() -> None:
    spec, protocol = DataSpec(5, ("Hip", "RHip")), Protocol(joints="Hip", cps_align="none", align="rigid")
    assert "mpjpe" in metrics_of(protocol, spec)
    assert not {"pck", "auc"} & metrics_of(protocol, spec).keys()
    assert {*curves_of(protocol, spec)} == {"errors_by_n", "cps_curve"}
    assert left_out(protocol, spec) == (
        "left out: pa_min_mpjpe, which need at least 2 joints to align; pck, auc, which need joints to score: "
        "none of pck_joints = h36m-14 is."
    )
    assert left_out(Protocol(joints="Hip", metrics="mpjpe"), spec) == left_out(Protocol(), PERSON) == ""
    assert {*metrics_of(Protocol(joints="Hip", metrics="mpjpe"), spec)} == {"mpjpe"}
    with pytest.raises(PoseDataError, match=r"^metrics: pck needs joints to score: none of pck_joints = h36m-14 is;"):
        metrics_of(Protocol(joints="Hip", metrics="pck"), spec)
