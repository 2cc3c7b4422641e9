"""Poses with different numbers of hypotheses: what is absent does not count, however it is written."""

from typing import Any

import numpy as np
import pytest

import posecal
from posecal.calibration.rank_tests import RANK_TESTS
from posecal.calibration.ranks import LEVELS
from posecal.engine.block import Block
from posecal.engine.merge import merge_totals
from posecal.errors import PoseDataError
from posecal.metrics import crps, diversity, energy_score, min_mpjpe, mpjpe, pck, radius
from tests.helpers.samplers import gaussian

Array = np.ndarray[Any, Any]
N, M, K = 7, 90, 5
X, Y = gaussian(0, N, M, K)
LIVE = np.random.default_rng(1).permuted(np.arange(N)[:, None] < np.random.default_rng(2).integers(2, N + 1, M), axis=0)
SEQUENCE = np.repeat(np.arange(9), 10).astype(str)


def padded(fill: str) -> tuple[Array, Array | None]:
    """The hypotheses with those that are absent as NaN, or as zeros of weight 0."""
    if fill == "NaN":
        return np.where(LIVE[..., None, None], X, np.nan), None
    return np.where(LIVE[..., None, None], X, 0.0), LIVE * np.random.default_rng(3).uniform(0.1, 1, (N, M))


def report_of(fill: str, metrics: str = "default, scores", **options: Any) -> posecal.Report:
    x, scores = padded(fill)
    options = {"labels": {"sequence": SEQUENCE}, "root_joint": "none", **options}
    return posecal.evaluate(x, Y, scores=scores, unit="mm", axes="NMKD", metrics=metrics, threads=1, **options)


@pytest.mark.parametrize("fill", ["NaN", "zeros"])
def test_every_number_is_that_of_the_hypotheses_that_are_there(fill: str) -> None:
    def mean(function: Any, **options: Any) -> float:
        of = [function(X[LIVE[:, m], m : m + 1], Y[m : m + 1], **options) for m in range(M)]
        return float(np.nanmean(np.concatenate(of)))

    report = report_of(fill, "all")
    right = {
        "min_mpjpe": mean(min_mpjpe),
        "mpjpe": mean(mpjpe),
        "median_mpjpe": mean(mpjpe, of="median"),
        "worst_mpjpe": mean(mpjpe, of="worst"),
        "pa_min_mpjpe": mean(min_mpjpe, align="similarity"),
        "mean_pose_mpjpe": mean(mpjpe, of="mean_pose"),
        "pck": mean(pck),
        "energy_score": mean(energy_score),
        "crps": mean(crps),
        "diversity": mean(diversity),
    }
    for name, value in right.items():
        assert report[name] == pytest.approx(value, rel=1e-6), name
    radii = np.concatenate([radius(X[LIVE[:, m], m : m + 1], Y[m : m + 1], share=0.9).ravel() for m in range(M)])
    assert report["radius_90"] == pytest.approx(radii.mean(), rel=1e-6)


def test_the_remark_says_how_many_are_absent_and_the_line_what_is_left_out() -> None:
    for fill in ("NaN", "zeros"):
        report = report_of(fill, "default")
        assert (
            f"hypotheses: {(~LIVE).sum()} hypotheses are absent (NaN, or of weight 0); a pose has up to N = 7."
        ) in report.remarks
        line = next(remark for remark in report.remarks if remark.startswith("left out: "))
        assert "ece" in line
        assert line.endswith("which need as many hypotheses of every pose.")
        assert not {"ece_paper", "min_mpjpe_at_5", "mpjve", "jitter", "brier"} & report.metrics.keys()
        assert report.summary[0].startswith("No miscalibration shown on average")


def test_curves_and_rank_tests_are_means_over_poses_of_any_number() -> None:
    report = report_of("NaN", "all")
    curves = [posecal.calibration_curve(X[LIVE[:, m], m : m + 1], Y[m : m + 1]).joints for m in range(M)]
    median = np.median(np.mean(curves, axis=0), axis=0)
    assert report["ece"] == pytest.approx(np.abs(median - LEVELS).mean(), abs=1e-9)
    for test in (test for test in RANK_TESTS if test.name not in {"coordinate_pit", "tarp_box"}):
        blocks = (Block(X[LIVE[:, m], m : m + 1], Y[m : m + 1]) for m in range(M))
        weights = [test.weights(block, np.ones(K, dtype=bool))[0, 0] for block in blocks]
        assert report[test.name] == pytest.approx(np.abs(np.nanmean(weights, axis=0) - LEVELS).mean(), abs=1e-9)
    number = round(LIVE.sum(axis=0).mean())
    assert report["effective_hypotheses"] == pytest.approx(LIVE.sum(axis=0).mean())
    assert report["ece_floor"] == posecal.perfect_sampler(number, M, K).mean


def test_poses_of_one_hypothesis_have_no_rank() -> None:
    x, _ = padded("NaN")
    x[1:, :9], x[0, :9] = np.nan, X[0, :9]
    options: dict[str, Any] = {"unit": "mm", "axes": "NMKD", "root_joint": "none", "metrics": "all"}
    whole, part = posecal.evaluate(x, Y, **options), posecal.evaluate(x[:, 9:], Y[9:], **options)
    for name in ("ece", "coordinate_pit", "average_rank", "tarp", "energy_score", "radius_50"):
        assert whole[name] == pytest.approx(part[name], rel=1e-9), name
    assert any(
        remark.startswith("9 poses of 90 have one hypothesis") and remark.endswith("are those of the other 81.")
        for remark in whole.remarks
    )
    assert not any("have one hypothesis" in remark for remark in part.remarks)


def test_weights_decide_the_weighted_pose() -> None:
    x, scores = padded("zeros")
    assert scores is not None
    weighted = (x * scores[..., None, None]).sum(axis=0) / scores.sum(axis=0)[:, None, None]
    right = np.linalg.norm(weighted - Y, axis=-1).mean()
    assert report_of("zeros", "weighted_pose_mpjpe")["weighted_pose_mpjpe"] == pytest.approx(right, rel=1e-6)


def parts_of(x: Array) -> list[posecal.Evaluation]:
    """An evaluation of each third of the poses."""
    parts = []
    for start in range(0, M, 30):
        rows = slice(start, start + 30)
        evaluation = posecal.Evaluation(unit="mm", axes="NMKD", root_joint="none", metrics="default")
        evaluation.update(x[:, rows], Y[rows], sequence=SEQUENCE[rows])
        parts.append(evaluation)
    return parts


def assert_one_call(found: posecal.Report, x: Array) -> None:
    labels = {"sequence": SEQUENCE}
    whole = posecal.evaluate(x, Y, unit="mm", axes="NMKD", root_joint="none", metrics="default", labels=labels)
    assert found.metrics.keys() == whole.metrics.keys()
    assert [remark for remark in found.remarks if "absent" in remark] == [r for r in whole.remarks if "absent" in r]
    for name, value in whole.scalars().items():
        assert found.scalars()[name] == pytest.approx(value, rel=1e-9, nan_ok=True), name


@pytest.mark.parametrize("full", [[], [0], [0, 1], [1], [2]])
def test_batches_give_what_one_call_gives(full: list[int]) -> None:
    """Also where the first ones, or later ones, have all hypotheses."""
    x, _ = padded("NaN")
    for third in full:
        x[:, 30 * third : 30 * third + 30] = X[:, 30 * third : 30 * third + 30]
    evaluation = posecal.Evaluation(unit="mm", axes="NMKD", root_joint="none", metrics="default")
    for start in range(0, M, 30):
        rows = slice(start, start + 30)
        evaluation.update(x[:, rows], Y[rows], sequence=SEQUENCE[rows])
    assert_one_call(evaluation.compute(), x)
    assert_one_call(posecal.Report(merge_totals([part.totals() for part in parts_of(x)])), x)


def test_a_batch_with_absent_hypotheses_that_is_refused_changes_nothing() -> None:
    x, _ = padded("NaN")
    evaluation, *_ = parts_of(X)
    x[:, 3] = np.nan
    with pytest.raises(PoseDataError, match="have no hypothesis"):
        evaluation.update(x[:, :30], Y[:30], sequence=SEQUENCE[:30])
    assert "ece_paper" in evaluation.compute().metrics


def test_groups_and_intervals_are_given() -> None:
    report = report_of("NaN", "mpjpe", by="sequence")
    errors = np.where(LIVE, np.linalg.norm(X - Y, axis=-1).mean(axis=-1), np.nan)
    first = np.nanmean(errors[:, :10], axis=0).mean()
    assert report.value("mpjpe", "sequence=0") == pytest.approx(first, rel=1e-9)
    low, high = report.interval("mpjpe")
    assert low < report["mpjpe"] < high


def test_a_pose_without_any_hypothesis_is_refused() -> None:
    x, _ = padded("NaN")
    x[:, 4] = np.nan
    with pytest.raises(
        PoseDataError, match=r"^hypotheses: 1 of 90 frames have no hypothesis \(first: 4\); expected at least one\."
    ):
        posecal.evaluate(x, Y, unit="mm", axes="NMKD", root_joint="none")


def test_part_of_a_hypothesis_that_is_not_finite_is_refused_as_ever() -> None:
    x, _ = padded("NaN")
    there = int(np.flatnonzero(LIVE[:, 8])[0])
    x[there, 8, 2, 1] = np.nan
    with pytest.raises(
        PoseDataError, match=r"^hypotheses has non-finite coordinates in 1 of 90 frames \(first: frame 8, "
    ):
        posecal.evaluate(x, Y, unit="mm", axes="NMKD", root_joint="none")


@pytest.mark.parametrize("options", [{"metrics": "ece_paper"}, {"metrics": "min_mpjpe_at_2"}])
def test_what_needs_as_many_hypotheses_of_every_pose_is_refused(options: dict[str, Any]) -> None:
    with pytest.raises(PoseDataError, match=r"as many hypotheses of every pose"):
        report_of("NaN", **options)


def test_scores_that_are_no_weights_make_nothing_absent() -> None:
    scores = np.random.default_rng(4).normal(0, 1, (N, M))
    scores[0, 0] = 0
    report = posecal.evaluate(X, Y, scores=scores, unit="mm", axes="NMKD", root_joint="none", metrics="default")
    assert "ece" in report.metrics


def test_absent_hypotheses_of_few_poses_are_found_wherever_they_are() -> None:
    """Few poses are looked at beforehand; the others are when coordinates are found that are not finite."""
    x, y = (np.concatenate([poses] * 6, axis=poses.ndim - 3) for poses in (X, Y))
    live = np.ones(x.shape[:2], dtype=bool)
    live[3:, 300:310] = False
    padded_ = np.where(live[..., None, None], x, np.nan)
    options: dict[str, Any] = {"unit": "mm", "axes": "NMKD", "root_joint": "none", "metrics": "mpjpe"}
    right = np.nanmean(np.nanmean(np.linalg.norm(padded_ - y, axis=-1).mean(axis=-1), axis=0))
    report = posecal.evaluate(padded_, y, **options)
    assert report["mpjpe"] == pytest.approx(right, rel=1e-9)
    assert any("40 hypotheses are absent" in remark for remark in report.remarks)
    evaluation = posecal.Evaluation(**options)
    for start in (0, 270):
        evaluation.update(padded_[:, start : start + 270], y[start : start + 270])
    assert evaluation.compute()["mpjpe"] == pytest.approx(right, rel=1e-9)
