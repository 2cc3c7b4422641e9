"""Every number that posecal knows can be explained."""

from __future__ import annotations

import pytest

from posecal.calibration.rank_tests import RANK_TESTS
from posecal.data.skeleton import JOINT_SETS
from posecal.engine.metric import DataSpec
from posecal.engine.protocol import Protocol
from posecal.errors import PoseDataError
from posecal.registry import known_metrics
from posecal.report.explain import explain, page
from tests.helpers.reports import report_of

SUBJECT = DataSpec(
    200,
    JOINT_SETS["h36m-17"],
    root=0,
    labels=("sequence",),
    has_scores=True,
    has_occlusion=True,
    preranks=("span",),
    reference="climatology",
)
KNOWN = known_metrics(Protocol(), SUBJECT)
PARTS = ("definition", "unit", "range", "direction", "how to read", "source")


@pytest.mark.parametrize("name", KNOWN)
def test_every_metric_has_its_definition_range_direction_source_and_how_to_read_it(name: str) -> None:
    lines = explain(name, spec=SUBJECT).splitlines()
    assert lines[0] == f"{name}: {KNOWN[name].label}"
    assert f"definition  {KNOWN[name].definition}" in lines
    for part in PARTS:
        (line,) = (line for line in lines[1:] if line.startswith(part))
        assert len(line) > len(part) + 3


@pytest.mark.parametrize("name", [name for name in KNOWN if name != "span"])
def test_it_can_be_explained_without_data(name: str) -> None:
    assert explain(name).startswith(f"{name}: ")


@pytest.mark.parametrize("test", RANK_TESTS, ids=lambda test: test.name)
def test_a_test_says_what_it_means_when_it_fires(test: object) -> None:
    assert f"if it fires {test.rejection}" in explain(test.name)  # type: ignore[attr-defined]


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
def test_a_metric_has_the_page_of_its_kind(name: str, words: str) -> None:
    assert words in page(KNOWN[name]).reading


def test_the_definition_is_written_out_for_the_options() -> None:
    assert "N=7" in explain("ece", spec=DataSpec(7, ("a", "b"), root=None))
    assert "80 mm" in explain("pck", Protocol(pck_threshold=80.0))


def test_every_number_that_a_report_prints_is_explained_by_its_own_label() -> None:
    for row in report_of(metrics="all", by=("occlusion",)).rows:
        assert explain(row.metric).splitlines()[0] == f"{row.metric}: {row.label}"


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("ece_null", "mean of ECE over random signs of whole sequences"),
        ("ece_null_95", "What the error is to be held against"),
        ("ece_paper_p", "None with fewer than six sequences"),
        ("tarp_p_adjusted", "adjusted for all tests (Holm)"),
        ("ece_reference_floor", "expected ECE (reference) of a perfect sampler"),
        ("ece_floor_95", "What N and M alone cost"),
        ("effective_poses", "Frames of a video resemble their neighbours"),
        ("squared_error", "lower is better"),
    ],
)
def test_numbers_that_stand_beside_errors_have_pages(name: str, words: str) -> None:
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
