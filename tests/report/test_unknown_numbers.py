"""Numbers that can't be computed are NaN, with their reason in a remark, and no sentence builds on them."""

from __future__ import annotations

import json
import math
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import posecal
from posecal.calibration.expected import ece_range
from posecal.engine.merge import merge_totals
from posecal.engine.storage import load_totals
from posecal.report.report import Report

Array = np.ndarray
LABELS = {"sequence": np.arange(48) // 6}


@cache
def world(n: int = 12) -> tuple[Array, Array]:
    """A calibrated sampler of four joints in eight sequences."""
    random = np.random.default_rng(3)
    truth = random.normal(0, 300, (48, 4, 3))
    return truth + random.normal(0, 40, (n, 48, 4, 3)) + random.normal(0, 40, (48, 4, 3)), truth


def report(hypotheses: Array, truth: Array, metrics: str = "default, rank_tests", **options: object) -> Report:
    return posecal.evaluate(hypotheses, truth, unit="mm", axes="NMKD", metrics=metrics, **{"labels": LABELS, **options})  # type: ignore[arg-type]


def with_resting_joint() -> tuple[Array, Array]:
    x, y = world()
    x = x.copy()
    x[:, :, 2] = y[:, 2]
    return x, y


def of_parts() -> Report:
    x, y = with_resting_joint()
    parts = (slice(0, 18), slice(18, 48))
    options = [{"labels": {"sequence": LABELS["sequence"][part]}} for part in parts]
    totals = [report(x[:, p], y[p], "default", **o).totals for p, o in zip(parts, options, strict=True)]
    return Report(merge_totals(totals, ["one", "other"]))


def saved(path: Path) -> Report:
    report(*with_resting_joint(), "default").save(path / "result.npz")
    return Report(load_totals(path / "result.npz"))


@pytest.mark.parametrize("way", ["whole", "merged", "saved"])
def test_a_joint_at_which_all_hypotheses_equal_the_truth_is_left_out_and_named(way: str, tmp_path: Path) -> None:
    x, y = with_resting_joint()
    whole = report(x, y, "default")
    found = {"whole": lambda: whole, "merged": of_parts, "saved": lambda: saved(tmp_path)}[way]()
    moving = [0, 1, 3]
    expected = report(x[:, :, moving], y[:, moving], "default")
    for name in ("ece", "ece_p", "ece_null", "ece_paper", "ece_mean", "signed_area", "coverage_90", "ece_floor"):
        np.testing.assert_allclose(found[name], expected[name], rtol=1e-6, err_msg=name)
    assert math.isnan(found.value("ece", joint="joint 2"))
    assert list(found.joint_tests()) == ["joint 0", "joint 1", "joint 3"]
    assert [r for r in found.remarks if "equal the truth" in r] == [
        "at joint 2 all hypotheses equal the truth in every pose: no calibration can be measured there, and its "
        "summaries over joints leave them out."
    ]


def test_hypotheses_that_equal_the_truth_are_not_said_to_be_calibrated() -> None:
    _, y = world()
    found = report(np.repeat(y[None], 12, axis=0), y)
    assert found.summary == ()
    for name in ("ece", "ece_p", "signed_area", "coverage_90", "tarp_box", "coordinate_pit", "mahalanobis_p"):
        assert math.isnan(found[name]), name
    assert found.joint_tests() == {}
    assert "all hypotheses equal the truth at every joint that counts: no calibration can be measured." in found.remarks


def test_copies_of_one_pose_are_not_tested() -> None:
    _, y = world()
    found = report(np.repeat(y[None] + 30, 12, axis=0), y)
    assert found["ece"] > 0.4
    (sentence,) = found.summary
    assert sentence.startswith("All hypotheses of a pose are the same: ")
    assert found.joint_tests() == {}
    for name in ("ece_p", "ece_null", "ece_null_95", "coordinate_pit_p", "mahalanobis_p"):
        assert math.isnan(found[name]), name
    remark = "the hypotheses of each pose are all the same: they have no spread that could be tested."
    assert remark not in found.remarks
    assert remark in report(np.repeat(y[None] + 30, 12, axis=0), y, metrics="ece").remarks


def test_of_one_sequence_tarp_has_no_box() -> None:
    found = report(*world(), labels={"sequence": np.zeros(48, dtype=int)})
    assert math.isnan(found["tarp_box"])
    assert not math.isnan(found["tarp"])
    said = [r for r in found.remarks if r.startswith("tarp_box")]
    assert said == [
        "tarp_box: no value, because the true poses of the other sequences have no range; expected several."
    ]
    assert not any(r.startswith("tarp_box") for r in report(*world()).remarks)


@pytest.mark.parametrize(
    ("n", "hidden", "words"),
    [(2, (80, 90, 95), "80, 90 or 95 %"), (5, (90, 95), "90 or 95 %"), (9, (95,), "95 %"), (19, (), "")],
)
def test_coverage_that_few_hypotheses_can_not_show_is_not_reported(n: int, hidden: tuple[int, ...], words: str) -> None:
    x, y = world(19)
    found = report(x[:n], y, "default")
    unknown = [p for p in (50, 80, 90, 95) if math.isnan(found[f"coverage_{p}"])]
    assert unknown == [*hidden]
    assert [p for p in unknown if math.isnan(found.calibration().coverage(p / 100))] == unknown
    assert not any(f"coverage_{p}" in found.headline_metrics for p in unknown)
    (said,) = (r for r in found.remarks if "are few" in r)
    low, high = ece_range(n)
    assert f"an ECE lies between {low:.2g} and {high:.2g};" in said
    assert f"no ball holds {words} of them, so that coverage is not known." in said or not hidden
    assert ("coverage" in said) == bool(hidden)
    assert ("90\u00a0% balls" in found.summary[0]) == (90 not in hidden)


def test_the_range_of_an_ece_stands_beside_it_where_hypotheses_are_few() -> None:
    x, y = world(20)
    assert report(x[:5], y, "ece").metrics["ece"].definition.endswith("; can be 0 to 0.4 at N=5")
    assert "can be" not in report(x, y, "ece").metrics["ece"].definition


@cache
def much_too_wide() -> Report:
    """Ten hypotheses that are ten times as wide as they should be."""
    random = np.random.default_rng(3)
    truth = random.normal(0, 300, (96, 4, 3))
    labels = {"sequence": np.arange(96) // 8}
    return report(
        truth + random.normal(0, 400, (10, 96, 4, 3)) + random.normal(0, 40, (96, 4, 3)), truth, labels=labels
    )


def test_what_a_calibrated_sampler_would_show_is_not_known_of_few_hypotheses_that_are_much_too_wide() -> None:
    found = much_too_wide()
    assert found["ece_p"] < 0.001
    assert [math.isnan(found[name]) for name in ("ece_null", "ece_null_95")] == [True] * 2
    assert math.isnan(found.test("ece").band)
    assert "; what chance alone gives a calibrated model is not known (p < 0.001)." in found.summary[0]
    (said,) = (remark for remark in found.remarks if remark.startswith("what a calibrated sampler would show"))
    assert "is not known" in said
    assert said in found.render("markdown").replace("&lt;", "<")
    row = next(line for line in found.render().splitlines() if line.startswith("ECE "))
    assert row.split()[-4:] == ["–", "–", "<", "0.001"]
    numbers = {row["metric"]: row["value"] for row in json.loads(found.render("json"))["rows"] if row["group"] is None}
    assert numbers["ece_null"] is None
    assert numbers["ece_p"] < 0.001


def test_no_picture_has_a_region_that_is_not_known() -> None:
    found = much_too_wide()
    both = posecal.compare({"one": found, "other": found})
    assert math.isnan(both.feasible())
    assert both.calibrated() == []
    assert any(text.startswith("No miscalibration shown on average: none") for text in both.render().splitlines())
    for ax in (posecal.plot.accuracy_and_calibration(both), posecal.plot.reliability(found)):
        assert not {"feasible", "band"} & {part.get_gid() for part in ax.get_children()}


def test_two_models_on_the_same_sequences_have_nearly_one_null() -> None:
    x, y = world()
    median = np.median(x, axis=0)
    narrow = report(median + 0.2 * (x - median), y)
    both = posecal.compare({"as drawn": report(x, y), "narrow": narrow})
    (one, other) = (both.test("ece", name).high for name in both.names)
    assert max(one, other) < 1.5 * min(one, other)
    assert both.feasible() == pytest.approx((one + other) / 2)
