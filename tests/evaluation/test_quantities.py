"""Angles, pixels and numbers without a unit, of one, two or three coordinates."""

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import posecal
from posecal.engine.circular import wrapped
from posecal.errors import PoseDataError
from posecal.report.format import number
from tests.helpers.shell import done, run

Array = np.ndarray[Any, Any]
N, M, K = 20, 48, 3
SEQUENCE = np.repeat(np.arange(12), 4).astype(str)


def angles(seed: int = 0, spread: float = 25.0) -> tuple[Array, Array]:
    """Hypotheses (N, M, K, 1) and truths (M, K, 1) all round the circle, in degrees."""
    random = np.random.default_rng(seed)
    centre = random.uniform(-180, 180, (M, K, 1))
    return centre + random.normal(0, spread, (N, M, K, 1)), centre + random.normal(0, spread, (M, K, 1))


def report_of(x: Array, y: Array, unit: str, metrics: str = "default, scores", **options: Any) -> posecal.Report:
    return posecal.evaluate(
        x, y, unit=unit, axes="NMKD", labels={"sequence": SEQUENCE[: len(y)]}, metrics=metrics, threads=1, **options
    )


# --- angles ---------------------------------------------------------------------------------------------------


def test_errors_of_angles_are_circular_distances() -> None:
    x, y = angles()
    apart = np.abs((x - y + 180) % 360 - 180)[..., 0].mean(axis=-1)
    report = report_of(x, y, "deg")
    assert report["mpjpe"] == pytest.approx(apart.mean(), rel=1e-9)
    assert report["min_mpjpe"] == pytest.approx(apart.min(axis=0).mean(), rel=1e-9)
    mean = np.degrees(np.angle(np.exp(1j * np.radians(x)).mean(axis=0)))
    of_mean = np.abs((mean - y + 180) % 360 - 180).mean()
    assert report["mean_pose_mpjpe"] == pytest.approx(of_mean, rel=1e-9)


def test_the_crps_of_angles_is_that_of_circular_distances() -> None:
    x, y = angles(spread=10.0)
    to_truth = np.abs((x - y + 180) % 360 - 180).mean(axis=0)
    among = np.abs((x[:, None] - x[None] + 180) % 360 - 180).sum(axis=(0, 1)) / (N * (N - 1))
    assert report_of(x, y, "deg", "crps")["crps"] == pytest.approx((to_truth - among / 2).mean(), rel=1e-9)


def test_hypotheses_opposite_of_the_truth_are_half_a_turn_off() -> None:
    x = np.array([170.0, -170, 175, -175]).reshape(4, 1, 1, 1) + np.zeros((4, M, K, 1))
    report = report_of(x, np.zeros((M, K, 1)), "deg")
    assert report["mean_pose_mpjpe"] == pytest.approx(180)
    assert report["mpjpe"] == pytest.approx(172.5)
    assert report["radius_90"] < 11


@pytest.mark.parametrize("change", ["turns of the hypotheses", "turns of the truth", "radians"])
def test_no_number_depends_on_how_an_angle_is_written(change: str) -> None:
    x, y = angles(1)
    random, unit = np.random.default_rng(2), "deg"
    other, other_truth = x, y
    if change == "turns of the hypotheses":
        other = x + 360 * random.integers(-2, 3, x.shape)
    elif change == "turns of the truth":
        other_truth = y + 360 * random.integers(-2, 3, y.shape)
    else:
        other, other_truth, unit = np.radians(x), np.radians(y), "rad"
    metrics = "default, scores, rank_tests"
    first, second = report_of(x, y, "deg", metrics), report_of(other, other_truth, unit, metrics)
    assert first.metrics.keys() == second.metrics.keys()
    for name in first.metrics:
        np.testing.assert_allclose(second[name], first[name], rtol=1e-7, atol=1e-9, equal_nan=True, err_msg=name)


def test_a_calibrated_sampler_of_angles_is_calibrated() -> None:
    random = np.random.default_rng(3)
    centre = random.uniform(-180, 180, (3000, 1, 1))
    x, y = centre + random.normal(0, 30, (50, 3000, 1, 1)), centre + random.normal(0, 30, (3000, 1, 1))
    report = posecal.evaluate(wrapped(x, 360), wrapped(y, 360), unit="deg", axes="NMKD")
    assert report["ece"] < 0.015
    assert report["coverage_90"] == pytest.approx(0.9, abs=4 * np.sqrt(0.09 / 3000))


def test_one_joint_without_an_axis_of_coordinates_is_an_angle() -> None:
    x, y = angles()
    flat = posecal.evaluate(x[..., 0], y[..., 0], unit="deg", axes="NMK", truth_axes="MK", metrics="mpjpe, ece")
    assert flat["mpjpe"] == pytest.approx(report_of(x, y, "deg")["mpjpe"], rel=1e-12)


# --- other units ----------------------------------------------------------------------------------------------


def pixels(d: int) -> tuple[Array, Array]:
    random = np.random.default_rng(d)
    y = random.normal(300, 80, (M, 5, d))
    return y + random.normal(0, 9, (N, M, 5, d)), y


@pytest.mark.parametrize(("unit", "shown"), [("px", " px"), ("none", ""), ("deg", " deg")])
@pytest.mark.parametrize("d", [1, 2, 3])
def test_a_default_report_of_every_quantity_prints_its_unit_and_no_other(unit: str, shown: str, d: int) -> None:
    x, y = pixels(d)
    report = report_of(x, y, unit, by=["sequence"])
    text = str(report)
    assert f" {number(report['mpjpe'], shown.strip(), report.interval('mpjpe'))} " in text
    for form in ("text", "markdown", "latex", "csv"):
        assert " mm" not in report.render(form, definitions=True).replace("150 mm", ""), form  # type: ignore[arg-type]
    units = {row["unit"] for row in json.loads(report.render("json"))["rows"]}
    assert units <= {"", shown.strip()}
    assert [remark for remark in report.remarks if remark.startswith("left out: ")]
    assert ("pa_min_mpjpe" in report.metrics) == (d == 3 and unit != "deg")


@pytest.mark.slow
@pytest.mark.parametrize(("unit", "shown"), [("deg", "deg"), ("rad", "deg"), ("px", "px"), ("none", "")])
@pytest.mark.parametrize("d", [1, 2, 3])
def test_the_commands_report_draw_and_compare_every_quantity_in_its_unit(
    unit: str, shown: str, d: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    x, y = pixels(d)
    np.savez("hyps.npz", hypotheses=np.radians(x) if unit == "rad" else x, axes="NMKD", unit=unit)
    np.savez("gt.npz", truth=np.radians(y) if unit == "rad" else y, unit=unit, sequence=SEQUENCE)
    wanted = ["--by", "sequence", "--per-joint", "--definitions", "--save", "result.npz", "--html", "page.html"]
    printed = done("evaluate", "hyps.npz", "gt.npz", *wanted)
    report = posecal.evaluate("hyps.npz", "gt.npz", threads=1)
    assert number(report["mpjpe"], shown, report.interval("mpjpe")) in printed
    assert printed.count("left out: ") == 1
    heading = f"MPJPE [{shown}]" if shown else "MPJPE "
    pages = {form: done("report", "result.npz", "--per-joint", "--format", form) for form in ("markdown", "latex")}
    assert heading in pages["markdown"]
    done("plot", "errors", "result.npz", "-o", "errors.svg")
    done("compare", "hyps.npz", "hyps.npz", "gt.npz", "--plot", "axes.svg")
    done("plot", "intervals", "hyps.npz", "gt.npz", "-o", "intervals.svg")
    pictures = {name: Path(name).read_text(encoding="utf-8") for name in ("errors.svg", "axes.svg", "intervals.svg")}
    for text in (printed, Path("page.html").read_text(encoding="utf-8"), *pages.values(), *pictures.values()):
        assert not re.search(r"\bmm\b", text)
    for text in pictures.values():
        assert (f"[{shown}]" in text) == bool(shown)
    refusal = run("plot", "pck", "result.npz", "-o", "pck.svg")
    assert refusal.exit_code == 3
    assert f"the data are {shown or 'no unit'}, D = {d}." in refusal.output


def test_skills_need_what_their_scores_need() -> None:
    x, y = angles()
    report = report_of(x, y, "deg", "scores", reference="climatology")
    assert {"crps_skill", "energy_skill"} <= report.metrics.keys()
    assert not {"variogram_skill", "brier_skill", "variogram_score", "brier"} & report.metrics.keys()


def test_a_line_says_which_metrics_are_left_out_and_why() -> None:
    x, y = pixels(2)
    assert (
        "left out: pa_min_mpjpe, which need positions of three coordinates; pck, auc, cps, which need lengths (or "
        "thresholds in the data's own unit)."
    ) in report_of(x, y, "px", "default").remarks
    with pytest.raises(
        PoseDataError, match=r"^metrics: pa_mpjpe needs positions of three coordinates; the data are px, D"
    ):
        report_of(x, y, "px", "pa_mpjpe")
    assert not [remark for remark in report_of(*pixels(3), "mm").remarks if remark.startswith("left out")]


def test_a_threshold_in_pixels_may_be_asked_for() -> None:
    x, y = pixels(2)
    report = report_of(
        x, y, "px", "pck", protocol=posecal.Protocol(pck_threshold=9.0, pck_best="mean", pck_joints="all")
    )
    assert report["pck"] == pytest.approx((np.linalg.norm(x - y, axis=-1) < 9).mean())
    assert report.metrics["pck"].label == "PCK 9 px"


def test_positions_of_no_length_scale_as_they_are() -> None:
    x, y = pixels(3)
    for name in ("mpjpe", "pa_min_mpjpe", "energy_score", "diversity", "radius_50"):
        scaled = report_of(x * 3, y * 3, "px", name)[name]
        assert scaled == pytest.approx(3 * report_of(x, y, "px", name)[name], rel=1e-9)


@pytest.mark.parametrize(("unit", "truth_unit"), [("deg", "mm"), ("px", "deg"), ("m", "none")])
def test_two_quantities_are_not_compared(unit: str, truth_unit: str) -> None:
    x, y = pixels(2)
    with pytest.raises(PoseDataError, match=r"^hypotheses is in .* and truth in .*; expected one quantity\."):
        posecal.evaluate(x, y, unit=unit, truth_unit=truth_unit, axes="NMKD")


def test_results_of_other_units_are_not_merged_or_compared() -> None:
    x, y = pixels(2)
    first, second = report_of(x, y, "px"), report_of(x, y, "none")
    assert "unit=px" in first.signature
    with pytest.raises(PoseDataError):
        posecal.merge_totals([first.totals, second.totals])
    with pytest.raises(PoseDataError):
        posecal.compare({"a": first, "b": second})
