"""Numbers averaged over groups, their nulls and curves: those of equally large groups."""

import math
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

import posecal
from posecal.calibration import LEVELS, perfect_sampler
from posecal.demo import make_world, sample
from posecal.engine.protocol import Protocol
from posecal.report.report import Report


def uneven() -> dict[str, Any]:
    """Eight sequences of 1, 2 and 3 frames of an overconfident sampler."""
    here = make_world(8, 3, seed=6)
    chosen = np.flatnonzero(np.arange(24) % 3 <= np.repeat([0, 1, 2, 0, 1, 2, 1, 0], 3))
    labels = {"sequence": here.sequence[chosen], "action": here.action[chosen]}
    return {"x": sample(here, 6, 0.6)[:, chosen], "y": here.truth[chosen], "labels": labels}


@cache
def averaged_and_repeated(label: str) -> tuple[Report, Report]:
    """The mean over groups, and all poses of as many copies of each group's that all groups are equally large."""
    data = uneven()
    values = data["labels"][label]
    size = np.array([(values == value).sum() for value in values])
    copies = np.repeat(np.arange(len(values)), math.lcm(*size.tolist()) // size)
    metrics = Protocol(metrics="default, rank_tests, ece_paper")
    one, other = (
        posecal.evaluate(
            data["x"][:, chosen],
            data["y"][chosen],
            joints="h36m-17",
            labels={name: words[chosen] for name, words in data["labels"].items()},
            unit="mm",
            axes="NMKD",
            protocol=protocol,
            by="action",
        )
        for chosen, protocol in ((slice(None), replace(metrics, average=label)), (copies, metrics))
    )
    return one, other


@pytest.mark.parametrize("label", ["sequence", "action"])
def test_averaged_calibration_and_its_null_are_those_of_equally_large_groups(label: str) -> None:
    one, other = averaged_and_repeated(label)
    for name, metric in one.metrics.items():
        if metric.family in {"calibration", "rank_tests"}:
            np.testing.assert_allclose(one.value(name), other.value(name), rtol=1e-9, err_msg=name)
        if metric.deviation is not None:
            found, expected = (vars(report.test(name)) for report in (one, other))
            # the noise of the median, which the null takes into account, is that of one frame, and copies share it
            np.testing.assert_allclose(list(found.values()), list(expected.values()), rtol=5e-2, err_msg=name)


@pytest.mark.parametrize("label", ["sequence", "action"])
def test_averaged_curves_are_those_of_equally_large_groups(label: str) -> None:
    one, other = averaged_and_repeated(label)
    for definition in ("exchangeable", "paper"):
        np.testing.assert_allclose(one.summary_curve(definition), other.summary_curve(definition), rtol=1e-9)
        curves = [report.calibration(definition).joints for report in (one, other)]
        np.testing.assert_allclose(*curves, rtol=1e-9)
    for name in ("coordinate_pit", "band_depth"):
        np.testing.assert_allclose(one.rank_curves(name), other.rank_curves(name), rtol=1e-9)
    assert one.joint_tests().keys() == other.joint_tests().keys()
    for joint, (area, p) in one.joint_tests().items():
        np.testing.assert_allclose((area, p), other.joint_tests()[joint], rtol=1e-9)
    np.testing.assert_allclose(one.curve("errors_by_n")[1], other.curve("errors_by_n")[1], rtol=1e-9)


def test_averaged_over_sequences_intervals_are_those_of_equally_long_ones() -> None:
    one, other = averaged_and_repeated("sequence")
    for name, metric in one.metrics.items():
        if not metric.statistic.per_pose:
            np.testing.assert_allclose(one.interval(name), other.interval(name), rtol=1e-9, err_msg=name)


def test_the_curve_that_is_drawn_is_the_one_whose_error_is_reported() -> None:
    one = averaged_and_repeated("action")[0]
    for group in (None, "action=sitting"):
        curve = one.summary_curve("exchangeable", group)
        np.testing.assert_allclose(np.abs(curve - LEVELS).mean(), one.value("ece", group), rtol=1e-9)


def test_the_floor_of_an_average_is_that_of_its_effective_number_of_poses() -> None:
    """Sequences of 1, 2, 3, 1, 2, 3, 2 and 1 poses: a mean of their means has the variance σ²/8² Σ 1/n = σ²/10.55."""
    effective = 8**2 / sum(1 / n for n in (1, 2, 3, 1, 2, 3, 2, 1))
    report = averaged_and_repeated("sequence")[0]
    assert f"{effective:.0f} independent poses" in report.definition("ece_floor")
    assert report["ece_floor"] == perfect_sampler(6, round(effective), 16).mean
