"""Every number that posecal knows can be explained, and the tables of the documentation are those explanations."""

from __future__ import annotations

from pathlib import Path
from runpy import run_path
from typing import get_args

import numpy as np
import pytest

from posecal.calibration.rank_tests import RANK_TESTS, Test
from posecal.data.skeleton import JOINT_SETS
from posecal.engine.metric import Family, Metric
from posecal.engine.protocol import CHOICES, Protocol
from posecal.engine.scope import DataSpec
from posecal.errors import PoseDataError
from posecal.registry import any_metrics, register, unregister
from posecal.report.explain import DIRECTIONS, EVERYTHING, explain, metrics_table
from tests.helpers.reports import report_of

SPEC = DataSpec(
    200,
    JOINT_SETS["h36m-17"],
    root=0,
    labels=("sequence",),
    has_scores=True,
    dimensions=48,
    has_occlusion=True,
    preranks=("span",),
    reference="climatology",
    clip_length=25,
    has_observed=True,
)
KNOWN = any_metrics(Protocol(), SPEC)
PARTS = ("definition", "unit", "range", "direction", "how to read", "source")


@pytest.mark.parametrize("name", KNOWN)
def test_every_metric_has_its_definition_range_direction_source_and_how_to_read_it(name: str) -> None:
    lines = explain(name, spec=SPEC).splitlines()
    assert lines[0] == f"{name}: {KNOWN[name].label}"
    assert f"definition  {KNOWN[name].definition}" in lines
    for part in PARTS:
        (line,) = (line for line in lines[1:] if line.startswith(part))
        assert len(line) > len(part) + 3


@pytest.mark.parametrize("name", [name for name in KNOWN if name != "span"])
def test_it_can_be_explained_without_data(name: str) -> None:
    assert explain(name).startswith(f"{name}: ")


@pytest.mark.parametrize(("option", "choice"), [(o, choice) for o, choices in CHOICES.items() for choice in choices])
def test_it_can_be_explained_without_data_whatever_the_options(option: str, choice: str) -> None:
    for name in ("min_mpjpe", "pck", "cps", "mpjve", "ece", "diversity"):
        assert explain(name, Protocol().changed({option: choice})).startswith(f"{name}: ")


@pytest.mark.parametrize("test", RANK_TESTS, ids=lambda test: test.name)
def test_a_test_says_what_its_rejection_means(test: Test) -> None:
    assert f"rejection   {test.rejection}" in explain(test.name)


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("ece", "Never 0 on finite data"),
        ("pa_min_mpjpe", "Falls with N for any model"),
        ("min_mpjpe_at_5", "Falls with N for any model"),
        ("worst_mpjpe", "it pays for the spread"),
        ("signed_area_max", "overconfident"),
        ("coverage_95", "of the balls that hold 90 %"),
        ("energy_skill", "a model that ignores the image has none"),
        ("brier_discrimination", "to which the hypotheses give a probability"),
        ("mean_pose_mpjve", "jitter"),
        ("radius_90", "Sharpness"),
    ],
)
def test_a_metric_is_explained_as_its_kind(name: str, words: str) -> None:
    assert words in KNOWN[name].reading
    assert words in explain(name)


def test_the_definition_is_written_out_for_the_options() -> None:
    assert "N=7" in explain("ece", spec=DataSpec(7, ("a", "b"), root=None))
    assert "80 mm" in explain("pck", Protocol(pck_threshold=80.0))


@pytest.mark.slow
def test_every_number_that_a_report_prints_is_explained_by_its_own_label() -> None:
    for row in report_of(metrics="all", by=("occlusion",)).rows:
        assert explain(row.metric).splitlines()[0] == f"{row.metric}: {row.label}"


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("ece_null", "mean of ECE over random signs of entire sequences"),
        ("ece_null_95", "Compare the error with it"),
        ("ece_paper_p", "None with fewer than six sequences"),
        ("tarp_p_adjusted", "adjusted for all tests (Holm)"),
        ("ece_reference_floor", "expected ECE (reference) of a perfect sampler"),
        ("ece_floor_95", "What N and M alone cost"),
        ("effective_poses", "Frames of a video resemble their neighbours"),
        ("squared_error", "lower is better"),
    ],
)
def test_numbers_beside_errors_are_explained(name: str, words: str) -> None:
    text = explain(name)
    assert words in text
    for part in PARTS:
        assert any(line.startswith(part) for line in text.splitlines())


@pytest.mark.parametrize("name", ["mpjpe_null", "ece_worst_floor", "ece_p_adjusted"])
def test_numbers_that_no_report_prints_are_not_explained(name: str) -> None:
    with pytest.raises(PoseDataError, match=r"is not known"):
        explain(name)


def test_an_unknown_name_is_refused_with_the_nearest() -> None:
    with pytest.raises(PoseDataError, match=r"explain: 'energy' is not known\. Did you mean"):
        explain("energy")


@pytest.mark.parametrize("name", [None, 3, ["ece"]])
def test_what_is_no_name_is_refused(name: object) -> None:
    with pytest.raises(PoseDataError, match=r"explain: .* is not known\."):
        explain(name)  # type: ignore[arg-type]


@pytest.mark.parametrize("name", KNOWN)
def test_every_metric_has_a_range_how_to_read_it_and_a_source(name: str) -> None:
    metric = KNOWN[name]
    assert metric.range
    assert metric.reading.endswith(".")
    assert metric.source
    assert "  " not in metric.range + metric.reading + metric.source


def test_a_metric_of_the_user_s_own_is_explained() -> None:
    def depth_error(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Mean absolute error along the third axis."""
        return np.abs(x - y)[..., 2].mean(axis=(0, 2))

    register(Metric.from_function(depth_error, range="0 mm upwards"))
    try:
        assert explain("depth_error").splitlines() == [
            "depth_error: depth error",
            "definition  Mean absolute error along the third axis.",
            "unit        mm",
            "range       0 mm upwards",
            "direction   lower is better",
        ]
    finally:
        unregister("depth_error")


# --- tables of the documentation -------------------------------------------------------------------------------------


@pytest.mark.parametrize("family", get_args(Family))
def test_the_table_of_a_family_names_each_of_its_metrics_once(family: Family) -> None:
    names = [name.strip("`") for row in metrics_table(family) for name in row[0].split(", ")]
    known = any_metrics(Protocol(), EVERYTHING)
    assert sorted(names) == sorted(name for name, metric in known.items() if metric.family == family)


@pytest.mark.parametrize("family", get_args(Family))
def test_the_metrics_of_a_row_have_one_unit_and_one_direction(family: Family) -> None:
    for names, _, unit, direction, _ in metrics_table(family):
        metrics = [KNOWN[name.strip("`")] for name in names.split(", ")]
        assert {metric.unit for metric in metrics} == {unit}
        assert {DIRECTIONS[metric.direction] for metric in metrics} == {direction}


def test_a_row_of_a_table_is_of_metrics_that_differ_in_a_prefix_or_a_number() -> None:
    rows = {row[0]: row[1:] for family in get_args(Family) for row in metrics_table(family)}
    assert rows["`mpjpe`, `pa_mpjpe`, `n_mpjpe`"] == (
        *("mean over poses of the mean of the N=200 errors; error: mean over the 17 joints (root counted) of ‖x − y‖",),
        *("mm", "lower is better", "`align`, `scale`"),
    )
    assert rows["`coverage_50`, `coverage_80`, `coverage_90`, `coverage_95`"][-1] == "`ece_over`"


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("min_mpjpe", "`align`, `align_best`, `scale`, `best`"),
        ("pck", "`align`, `pck_rule`, `pck_best`, `pck_threshold`, `pck_joints`"),
        ("mpjve", "`velocity`"),
        ("jitter", "`velocity`"),
        ("pve", "`align`"),
        ("w_mpjpe", "`segment`"),
        ("diversity", "`deviation`"),
        ("tarp", ""),
    ],
)
def test_a_table_says_which_options_change_a_metric(name: str, options: str) -> None:
    (row,) = (row for family in get_args(Family) for row in metrics_table(family) if row[0].startswith(f"`{name}`"))
    assert row[-1] == options


def test_the_table_of_joint_sets_is_that_of_the_package() -> None:
    page = Path(__file__).parents[2] / "docs" / "joints.md"
    text, generated = page.read_text(encoding="utf-8"), run_path(str(page.with_name("generate.py")))["generated"]
    assert text == generated(text), "run python docs/generate.py"
    assert text.count("\n| `") == len(JOINT_SETS) + 5  # with the table of roots
    assert "RHip\N{NO-BREAK SPACE}(0)" in text


def test_the_tables_of_the_documentation_are_those_of_the_metrics() -> None:
    page = Path(__file__).parents[2] / "docs" / "metrics.md"
    text, generated = page.read_text(encoding="utf-8"), run_path(str(page.with_name("generate.py")))["generated"]
    assert text == generated(text), "run python docs/generate.py"
    for family in get_args(Family):
        assert f"<!-- metrics: {family} -->" in text
        assert generated(f"<!-- metrics: {family} -->\n<!-- end -->").count("\n| ") == len(metrics_table(family)) + 2
    assert "<!-- options: all -->" in text
    assert generated(text.replace("150 mm", "160 mm")) != text.replace("150 mm", "160 mm")
