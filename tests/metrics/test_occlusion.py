"""Numbers by occlusion: which of them are given, and what a report says they are of."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import posecal
from tests.helpers.samplers import gaussian

M, K = 12, 5


def report_of(metrics: str, **options: Any) -> posecal.Report:
    x, y = gaussian(0, 4, M, K)
    labels = {"sequence": np.repeat(["a", "b"], M // 2)}
    how = posecal.Protocol(metrics=metrics, **options)
    given: dict[str, Any] = {"unit": "mm", "axes": "NMKD", "root_joint": 0, "labels": labels}
    occluded = np.arange(M * K).reshape(M, K) % 3 == 0
    return posecal.evaluate(x, y, occluded=occluded, by="occlusion", protocol=how, **given)


def said(report: posecal.Report) -> list[str]:
    return [remark for remark in report.remarks if remark.startswith("numbers by occlusion")]


@pytest.mark.parametrize(
    ("metrics", "names"),
    [
        ("mpjpe", ["mpjpe"]),
        ("radius_50, crps, min_mpjpe", ["min_mpjpe", "radius_50"]),
        ("crps", ["min_mpjpe", "mpjpe", "ece", "signed_area", "coverage_90", "radius_50"]),
        ("default, mpjpe", ["min_mpjpe", "mpjpe", "ece", "signed_area", "coverage_90", "radius_50"]),
    ],
)
def test_the_numbers_that_were_asked_for_are_given_or_all(metrics: str, names: list[str]) -> None:
    report = report_of(metrics)
    assert list(report.metrics_in("occlusion=visible")) == list(report.metrics_in("occlusion=occluded")) == names
    more = "; what was asked for is not among them" * (metrics == "crps")
    assert said(report) == [
        f"numbers by occlusion: means over the occluded or visible ones of {K - 1} joints (no root){more}."
    ]


@pytest.mark.parametrize("best", ["sequence", "batch:2", "joint"])
def test_the_best_hypothesis_for_the_joints_of_each_pose_is_said_to_be_no_other(best: str) -> None:
    x, y = gaussian(0, 4, M, K)
    x, y = x - x[:, :, :1], y - y[:, :1]
    occluded = np.arange(M * K).reshape(M, K) % 3 == 0
    occluded[:, 0] = False
    errors = np.where(occluded, np.linalg.norm(x - y, axis=-1), np.nan)
    report = report_of("min_mpjpe", best=best)
    right = np.nanmean(errors, axis=-1).min(axis=0).mean()
    assert report.value("min_mpjpe", "occlusion=occluded") == pytest.approx(right, rel=1e-6)
    assert said(report)[0].endswith(
        f"; minMPJPE of the best hypothesis for these joints of each pose, not by best={best}."
    )
    assert said(report_of("mpjpe", best=best)) == said(report_of("mpjpe"))
