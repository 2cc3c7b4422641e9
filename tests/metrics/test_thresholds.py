"""AUC over any range, aligned PCK, and thresholds that are shares of a length of the body."""

from typing import Any

import numpy as np
import pytest

import posecal
from posecal.errors import PoseDataError
from posecal.metrics import auc
from tests.helpers.oracles import aligned, joint_errors
from tests.situations.people import JOINTS, about, people

Array = np.ndarray[Any, Any]


def model(m: int = 30) -> tuple[Array, Array]:
    random = np.random.default_rng(0)
    truth = people(random, m)
    hypotheses = about(random, truth, 6, spread=30)
    return hypotheses - hypotheses[:, :, :1], truth


def report_of(x: Array, y: Array, metrics: str, joints: Any = JOINTS, **options: Any) -> posecal.Report:
    how = posecal.Protocol(metrics=metrics, pck_joints="all", root="drop", **options)
    return posecal.evaluate(x, y, unit="mm", axes="NMKD", joints=joints, protocol=how, threads=1)


def own_best(distances: Array, thresholds: Array) -> Array:
    return np.array([(distances < t).mean(axis=-1).max(axis=0).mean() for t in thresholds])


@pytest.mark.parametrize(("first", "last", "number"), [(0, 50, 100), (20, 50, 31), (0, 150, 31), (10, 11, 2)])
def test_an_auc_is_over_the_thresholds_that_are_asked_for(first: float, last: float, number: int) -> None:
    x, y = model()
    distances = np.linalg.norm(x - y, axis=-1)[..., 1:]
    at = np.linspace(first, last, number)
    curve = own_best(distances, at)
    text = f"{first}:{last}:{number}"
    assert report_of(x, y, "auc", auc_range=text)["auc"] == pytest.approx(curve.mean(), abs=1e-12)
    trapezoid = report_of(x, y, "auc", auc_range=text, auc="trapezoid")["auc"]
    assert trapezoid == pytest.approx(np.trapezoid(curve, at) / (last - first), abs=1e-12)
    fine = np.linspace(first, last, 200_001)[1::2]
    integral = report_of(x, y, "auc", auc_range=text, auc="integral")["auc"]
    one = np.array([(distances[:, 0] < t).mean(axis=-1).max() for t in fine[::100]]).mean()
    assert auc(x[:, :1, 1:], y[:1, 1:], thresholds=(first, last, number), area="integral")[0] == pytest.approx(
        one, abs=0.01
    )
    assert 0 <= integral <= 1


def test_the_thresholds_of_an_auc_are_written_out() -> None:
    x, y = model()
    for text, shown in (("0:150:5", "the 5 thresholds 0, 37.5, … 150 mm"), ("10:20:2", "the 2 thresholds 10, 20 mm")):
        report = report_of(x, y, "auc", auc_range=text)
        assert f"mean over {shown} of PCK" in report.definition("auc")
        assert f"mean of PCK over {shown}" in report.render(all=True)


def test_an_aligned_pck_and_auc_are_of_aligned_distances() -> None:
    x, y = model()
    moved = joint_errors(aligned(x, y, np.ones(y.shape[:2], dtype=bool), "similarity"), y)[..., 1:]
    report = report_of(x, y, "pa_pck, pa_auc", pck_threshold=40.0, auc_range="0:100:21")
    assert report["pa_pck"] == pytest.approx(own_best(moved, np.array([40.0]))[0], abs=1e-9)
    assert report["pa_auc"] == pytest.approx(own_best(moved, np.linspace(0, 100, 21)).mean(), abs=1e-9)


@pytest.mark.parametrize(
    ("relative", "ends"),
    [
        ("torso", (("LHip", "RHip"), ("LShoulder", "RShoulder"))),
        ("head", (("Head",), ("Thorax",))),
        ("LShoulder - RHip", (("LShoulder",), ("RHip",))),
        ("LHip+RHip - Head", (("LHip", "RHip"), ("Head",))),
    ],
)
@pytest.mark.parametrize("select", ["own", "mean", "linked"])
def test_thresholds_are_shares_of_a_true_length(relative: str, ends: Any, select: str) -> None:
    x, y = model()
    first, second = (y[:, [JOINTS.index(name) for name in end]].mean(axis=1) for end in ends)
    length = np.linalg.norm(first - second, axis=-1)
    distances = np.linalg.norm(x - y, axis=-1)
    right = (distances[..., 1:] < 0.15 * length[:, None]).mean(axis=-1)
    best = distances[..., 1:].mean(axis=-1).argmin(axis=0)
    expected = {"own": right.max(axis=0), "mean": right.mean(axis=0), "linked": right[best, np.arange(30)]}[select]
    report = report_of(x, y, "pck", pck_relative=relative, pck_threshold=0.15, pck_best=select)
    assert report["pck"] == pytest.approx(expected.mean(), abs=1e-12)
    area = report_of(x, y, "auc", pck_relative=relative, pck_threshold=0.15, auc_range="0:0.5:11", pck_best="mean")
    shares = [(distances[..., 1:] < t * length[:, None]).mean() for t in np.linspace(0, 0.5, 11)]
    assert area["auc"] == pytest.approx(np.mean(shares), abs=1e-9)


def test_a_pose_without_the_length_does_not_count() -> None:
    x, y = model()
    y[3, JOINTS.index("Head")] = y[3, JOINTS.index("Thorax")]
    where = np.ones(y.shape[:2], dtype=bool)
    where[5, JOINTS.index("Head")] = False
    how = posecal.Protocol(metrics="pck", pck_relative="head", pck_threshold=0.5)
    report = posecal.evaluate(x, y, where=where, unit="mm", axes="NMKD", joints=JOINTS, protocol=how)
    assert report.count("pck") == 28


def test_what_a_length_needs_is_said() -> None:
    x, y = model()
    with pytest.raises(PoseDataError, match=r"^pck_relative: head needs Head, which the poses don't have\.$"):
        report_of(x[:, :, :10], y[:, :10], "pck", JOINTS[:10], pck_relative="head", pck_threshold=0.5)
    with pytest.raises(PoseDataError, match=r"^pck_threshold: 150 with pck_relative: 'torso'; expected a share of it"):
        posecal.Protocol(pck_relative="torso")
    with pytest.raises(PoseDataError, match=r"^pck_relative: 'bbox'; expected none, torso, head, or two joints as L"):
        report_of(x, y, "pck", pck_relative="bbox", pck_threshold=0.5)
    for text in ("50", "0:50", "50:0:10", "0:50:1", "0:inf:3", "a:b:c"):
        with pytest.raises(
            PoseDataError, match=r"^auc_range: .*; expected first:last:how many \(no step\), such as 0:50:100\.$"
        ):
            posecal.Protocol(auc_range=text)
