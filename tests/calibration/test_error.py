"""Numbers that are read off calibration curves, against loops and published values."""

from __future__ import annotations

import json
from pathlib import Path
from typing import get_args

import numpy as np
import numpy.typing as npt
import pytest

from posecal.calibration import (
    LEVELS,
    OVER_JOINTS,
    CalibrationCurve,
    OverJoints,
    calibration_curve,
    ece,
    expected_curve,
)
from posecal.calibration.curve import (
    MANY,
    coverage_at,
    curve_of,
    ece_over_joints,
    joint_ece,
    signed_area,
    summary_curve,
)
from posecal.calibration.error import calibration_metrics
from posecal.engine.metric import Metric
from posecal.engine.protocol import Protocol
from posecal.engine.scope import DataSpec, Scope
from posecal.errors import PoseDataError
from tests.helpers import calibration_oracles, oracles
from tests.helpers.random_worlds import skewed

Array = npt.NDArray[np.floating]

NEVER, ALWAYS = np.zeros(21), np.ones(21)


@pytest.fixture
def curve() -> CalibrationCurve:
    """Five joints, of which one never counts."""
    random = np.random.default_rng(0)
    coverage = np.sort(random.random((5, 21)), axis=1)
    coverage[2] = np.nan
    return CalibrationCurve("exchangeable", coverage, np.sort(random.random(21)))


# --- against the loops -----------------------------------------------------------------------------------------------


def test_the_ece_of_a_joint_is_its_mean_distance_from_the_diagonal(curve: CalibrationCurve) -> None:
    expected = [calibration_oracles.curve_ece(row) for row in curve.joints]
    np.testing.assert_allclose(joint_ece(curve.joints), expected)
    np.testing.assert_allclose(curve.joint_ece(), expected)


@pytest.mark.parametrize("over", OVER_JOINTS)
def test_the_ece_over_joints_is_the_summary_s(curve: CalibrationCurve, over: OverJoints) -> None:
    np.testing.assert_allclose(curve.ece(over), calibration_oracles.ece(curve.joints, curve.pooled, over))


@pytest.mark.parametrize("over", OVER_JOINTS)
def test_the_summary_curve_is_the_loops(curve: CalibrationCurve, over: OverJoints) -> None:
    expected = calibration_oracles.over_joints(curve.joints, curve.pooled, over)
    table = np.concatenate([curve.joints, curve.pooled[None]])
    np.testing.assert_allclose(summary_curve(table, over), expected)
    np.testing.assert_allclose(curve.summary(over), expected)
    np.testing.assert_allclose(curve.signed_area(over), calibration_oracles.curve_area(expected))
    np.testing.assert_array_equal(curve_of(table, "paper").joints, curve.joints)
    np.testing.assert_array_equal(curve_of(table, "paper").pooled, curve.pooled)


def test_the_ece_is_of_the_median_unless_it_is_said(curve: CalibrationCurve) -> None:
    assert curve.ece() == curve.ece("median") != curve.ece("mean")
    assert curve.signed_area() == curve.signed_area("median") != curve.signed_area("mean")
    assert curve.coverage(0.9) == curve.coverage(0.9, "median") != curve.coverage(0.9, "mean")


def test_the_signed_area_is_the_trapezoid(curve: CalibrationCurve) -> None:
    expected = [calibration_oracles.curve_area(row) for row in curve.joints]
    np.testing.assert_allclose(signed_area(curve.joints), expected)
    np.testing.assert_allclose(curve.joint_signed_area(), expected)


@pytest.mark.parametrize("level", [0, 0.5, 0.8, 0.9, 0.95, 1.0, 0.33, 0.999, 1e-3])
def test_coverage_at_a_level_is_interpolated(curve: CalibrationCurve, level: float) -> None:
    expected = [np.interp(level, LEVELS, row) for row in curve.joints]
    np.testing.assert_allclose(coverage_at(curve.joints, level), expected)
    np.testing.assert_allclose(curve.joint_coverage(level), expected)
    np.testing.assert_allclose(curve.coverage(level), np.interp(level, LEVELS, np.nanmedian(curve.joints, axis=0)))


# --- extremes --------------------------------------------------------------------------------------------------------


def test_the_diagonal_has_no_error() -> None:
    assert joint_ece(LEVELS) == 0
    np.testing.assert_allclose(signed_area(LEVELS), 0, atol=1e-15)


@pytest.mark.parametrize(("coverage", "area"), [(NEVER, -0.5), (ALWAYS, 0.5)])
def test_the_largest_error_is_one_half(coverage: Array, area: float) -> None:
    np.testing.assert_allclose(joint_ece(coverage), 0.5)
    np.testing.assert_allclose(signed_area(coverage), area)


def test_below_the_diagonal_is_overconfident_and_negative() -> None:
    # ∫ q² - q = 1/3 - 1/2, and the trapezoid over 20 steps of a parabola adds 1/(6 · 20²).
    np.testing.assert_allclose(signed_area(LEVELS**2), 1 / 3 - 1 / 2 + 1 / 2400)


def test_joints_that_err_in_opposite_ways_cancel_in_the_median_and_not_in_the_mean() -> None:
    coverage = np.stack([LEVELS - 0.5 * LEVELS * (1 - LEVELS), LEVELS + 0.5 * LEVELS * (1 - LEVELS)])
    found = CalibrationCurve("exchangeable", coverage, LEVELS)
    np.testing.assert_allclose(found.ece(), 0, atol=1e-15)
    # the mean of q (1 - q) over 21 levels is 133/840 = 19/120
    np.testing.assert_allclose([found.ece("mean"), found.ece("worst")], 0.5 * 19 / 120)


@pytest.mark.parametrize("over", OVER_JOINTS)
def test_where_nothing_counts_there_is_no_number(over: OverJoints) -> None:
    nothing = CalibrationCurve("paper", np.full((3, 21), np.nan), np.full(21, np.nan))
    assert np.isnan([nothing.ece(over), nothing.signed_area(over), nothing.coverage(0.5, over)]).all()
    assert np.isnan(nothing.summary(over)).all()


# --- published numbers -----------------------------------------------------------------------------------------------


PUBLISHED = json.loads((Path(__file__).parents[1] / "fixtures" / "published_calibration_curves.json").read_text())[
    "curves"
]


@pytest.mark.parametrize(
    ("model", "number"),
    [
        ("Sharma et al.", 0.3588),
        ("Wehrbein et al.", 0.1785),
        ("Wehrbein et al., occluded joints", 0.2586),
        ("cGNF", 0.0825),
        ("cGNF, shipped array", 0.0627),
    ],
)
def test_published_curves_have_their_published_ece(model: str, number: float) -> None:
    median = np.array(PUBLISHED[model])
    found = CalibrationCurve("reference", median[None], median).ece()
    np.testing.assert_allclose(found, number, atol=5e-5)
    np.testing.assert_allclose(found, np.mean([abs(w - i / 20) for i, w in enumerate(PUBLISHED[model])]))


@pytest.mark.parametrize(("model", "table"), [("Sharma et al.", 0.36), ("Wehrbein et al.", 0.18), ("cGNF", 0.08)])
def test_published_ece_round_to_the_paper_s_table(model: str, table: float) -> None:
    assert round(float(joint_ece(np.array(PUBLISHED[model]))), 2) == table


def test_all_published_models_are_overconfident() -> None:
    assert all(signed_area(np.array(curve)) < 0 for curve in PUBLISHED.values())


# --- words -----------------------------------------------------------------------------------------------------------


def test_the_summaries_are_those_of_the_type() -> None:
    assert get_args(OverJoints) == OVER_JOINTS


def test_an_unknown_summary_is_refused_with_the_nearest(curve: CalibrationCurve) -> None:
    words = r"over: 'medain' is not known\. Did you mean median\?"
    calls = (curve.ece, curve.summary, curve.signed_area, lambda over: curve.coverage(0.5, over))
    for call in (*calls, lambda over: ece(*skewed(0, 3, 2, 2), over=over)):
        with pytest.raises(PoseDataError, match=words):
            call("medain")  # type: ignore[arg-type]


@pytest.mark.parametrize("level", [-0.01, 1.01, float("nan"), True, "0.5", None, 0.5j, [0.5]])
def test_a_level_is_a_share(curve: CalibrationCurve, level: object) -> None:
    for call in (curve.coverage, curve.joint_coverage):
        with pytest.raises(PoseDataError, match=r"level: .*; expected a share from 0 to 1\."):
            call(level)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "curves", [None, "curve", 3.0, [1.0, 2.0], LEVELS * 1j, CalibrationCurve("paper", LEVELS, LEVELS)]
)
def test_what_is_no_curve_is_refused(curves: object) -> None:
    for function in (joint_ece, signed_area):
        with pytest.raises(PoseDataError, match=r"^curves"):
            function(curves)  # type: ignore[arg-type]


# --- of arrays, and of stacks ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("over", OVER_JOINTS)
@pytest.mark.parametrize("definition", ["exchangeable", "paper", "reference"])
def test_the_ece_of_arrays_is_that_of_their_curve(over: OverJoints, definition: str) -> None:
    x, y = skewed(3, 7, 30, 4)
    where = np.random.default_rng(0).random((30, 4)) < 0.8
    options = {"definition": definition, "where": where, "root": 1}
    found = ece(x, y, over=over, **options)  # type: ignore[arg-type]
    assert type(found) is float
    assert found == calibration_curve(x, y, **options).ece(over)  # type: ignore[arg-type]
    x, y = oracles.relative(x, 1), oracles.relative(y, 1)
    weights = calibration_oracles.inside(x, y, oracles.relative_mask(where, 1) & (np.arange(4) != 1), definition)
    np.testing.assert_allclose(
        found,
        calibration_oracles.ece(calibration_oracles.curves(weights), calibration_oracles.pooled_curve(weights), over),
    )


@pytest.mark.parametrize("K", [MANY, MANY + 1, MANY + 2])
def test_the_median_over_many_joints_is_that_of_those_that_count(K: int) -> None:
    tables = np.random.default_rng(K).random((3, K + 1, 21))
    np.testing.assert_allclose(summary_curve(tables, "median"), np.median(tables[:, :-1], axis=1), rtol=1e-12)
    tables[1, [0, 5, 7]] = np.nan
    np.testing.assert_allclose(summary_curve(tables, "median"), np.nanmedian(tables[:, :-1], axis=1), rtol=1e-12)


@pytest.mark.parametrize("K", [1, 2, 4, 5])
@pytest.mark.parametrize("over", OVER_JOINTS)
def test_a_stack_of_tables_is_summarized_one_by_one(over: OverJoints, K: int) -> None:
    """Joints that don't count are NaN in all tables, or in some of them only; in the first none counts."""
    random = np.random.default_rng(K)
    tables = random.random((2, 6, K + 1, 21))
    tables[..., :-1, :][random.random((2, 6, K)) < 0.4] = np.nan
    tables[0, 0] = np.nan
    tables[np.isnan(tables[..., :-1, 0]).all(axis=-1)] = np.nan
    for index in np.ndindex(2, 6):
        by_joint, pooled = tables[index][:-1], tables[index][-1]
        expected = calibration_oracles.over_joints(by_joint, pooled, over)
        np.testing.assert_allclose(summary_curve(tables, over)[index], expected)
        np.testing.assert_allclose(
            ece_over_joints(tables, over)[index], calibration_oracles.ece(by_joint, pooled, over)
        )


# --- entries of reports ----------------------------------------------------------------------------------------------


def entries(**options: str) -> dict[str, Metric]:
    """The calibration metrics of 7 hypotheses of three joints, of which one is the root."""
    scope = Scope(Protocol(**options), DataSpec(7, ("a", "b", "c"), root=0))
    return {metric.name: metric for metric in calibration_metrics(scope)}


WORDS = {
    "median": ("the median over the 2 joints", "median of 2 joints"),
    "mean": ("the mean over the 2 joints", "mean of 2 joints"),
    "worst": ("the worst of the 2 joints", "worst of 2 joints"),
    "pooled": ("per pose the mean over the 2 joints", "pooled over 2 joints"),
}


@pytest.mark.parametrize("over", OVER_JOINTS)
def test_definitions_say_the_summary_over_joints(over: OverJoints) -> None:
    long, short = WORDS[over]
    for name, metric in entries(ece_over=over).items():
        if name in {"ece", "ece_paper", "ece_reference"}:
            assert metric.definition.startswith(f"mean over q of |ω(q) − q|, ω: {long} (no root);")
            assert f"; {short} (no root)" in metric.brief
        if name == "signed_area" or name.startswith("coverage"):
            assert f"{long} (no root)" in metric.definition
    assert "mean of 2 joints" in entries(ece_over=over)["ece_mean"].brief
    assert "worst of 2 joints" in entries(ece_over=over)["ece_paper_worst"].brief


def test_the_offset_of_a_definition_is_what_a_perfect_sampler_s_curve_is_off_by() -> None:
    for name, metric in entries().items():
        definition = next((d for d in ("paper", "reference") if d in name), None)
        if definition is None:
            assert metric.offset is None
        else:
            np.testing.assert_array_equal(metric.offset, expected_curve(7, definition) - LEVELS)


@pytest.mark.parametrize("percent", [50, 80, 90, 95])
def test_a_coverage_reads_the_curve_at_its_level(percent: int) -> None:
    metric, table = entries()[f"coverage_{percent}"], np.tile(LEVELS, (4, 1))
    if percent > 87.5:  # of 7 hypotheses
        assert np.isnan(metric.finish(table))
        assert metric.brief == "not known of N=7"
        assert metric.definition.endswith("; NaN, since no ball of N=7 hypotheses holds this share of them")
    else:
        assert metric.finish(table) == pytest.approx(percent / 100)
        assert metric.brief == f"best: {percent / 100:g}"
        assert metric.definition.endswith(f"; best: {percent / 100:g}")
    assert f"holds {percent} % of the hypotheses" in metric.definition
    assert metric.label == f"coverage at {percent} %"


def test_signed_areas_are_the_smallest_and_the_largest_of_joints() -> None:
    table = np.stack([np.full(21, np.nan), 0 * LEVELS, LEVELS**2, LEVELS])
    found = {name: float(metric.finish(table)) for name, metric in entries().items() if name.startswith("signed")}
    assert found["signed_area_min"] == pytest.approx(-0.5)
    assert found["signed_area_max"] == pytest.approx(1 / 3 - 1 / 2 + 1 / 2400)
