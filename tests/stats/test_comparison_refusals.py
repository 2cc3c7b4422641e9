"""What can't be compared, or not by its number as it stands."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from posecal.engine.metric import Metric
from posecal.engine.totals import Totals
from posecal.errors import PoseDataError
from posecal.report.comparison import Comparison, compare_totals
from posecal.stats.resampling import LEVEL
from tests.helpers.comparisons import LABELS, M, S, X, Y, totals_of
from tests.helpers.samplers import sequences


def test_results_that_were_not_made_alike_are_refused_with_what_differs() -> None:
    with pytest.raises(PoseDataError, match=r"^a and b were not made alike: align similarity against rigid\. Evaluate"):
        compare_totals([totals_of(X, Y), totals_of(X, Y, align="rigid")], ["a", "b"])
    with pytest.raises(
        PoseDataError, match=r"N 12 against 5.*same options; n_hypotheses takes as many hypotheses of each"
    ):
        compare_totals([totals_of(X, Y), totals_of(X[:5], Y)], ["a", "b"])
    with pytest.raises(PoseDataError, match=r"best frame against sequence\. Evaluate both with the same options\.$"):
        compare_totals([totals_of(X, Y), totals_of(X, Y, best="sequence")], ["a", "b"])


def test_all_models_that_can_t_be_compared_are_named_at_once() -> None:
    models = {"a": totals_of(X, Y), "b": totals_of(X[:5], Y), "c": totals_of(X, Y), "d": totals_of(X, Y + 5.0)}
    with pytest.raises(PoseDataError, match=r"^2 problems:\n  - a and b were not made alike: .*\n  - a and d were "):
        compare_totals([*models.values()], [*models])


def test_other_poses_are_refused_with_how_many_there_are() -> None:
    half = {"sequence": LABELS["sequence"][: M // 2]}
    with pytest.raises(PoseDataError, match=r"a and b hold other poses: 48 in 8 sequences and 24 in 4"):
        compare_totals([totals_of(X, Y), totals_of(X[:, : M // 2], Y[: M // 2], labels=half)], ["a", "b"])


@pytest.mark.parametrize("average", ["poses", "sequence"])
def test_as_many_poses_in_other_numbers_of_each_sequence_are_refused(average: str) -> None:
    one, other = (np.repeat(["a", "b", "c"], lengths) for lengths in ([16, 16, 16], [15, 17, 16]))
    pair = [totals_of(X, Y, "mpjpe", {"sequence": labels}, average=average) for labels in (one, other)]
    with pytest.raises(PoseDataError, match=r"a and b hold other poses: 48 in 3 sequences and 48 in 3 sequences\."):
        compare_totals(pair, ["a", "b"])


def test_as_many_poses_in_sequences_of_other_names_are_refused() -> None:
    renamed = np.where(LABELS["sequence"] == "s000", "t000", LABELS["sequence"])
    pair = [totals_of(X, Y, "mpjpe", labels) for labels in (LABELS, {"sequence": renamed})]
    with pytest.raises(PoseDataError, match=r"a and b hold other poses: 48 in 8 sequences and 48 in 8 sequences\."):
        compare_totals(pair, ["a", "b"])


def test_poses_in_another_order_within_their_sequences_are_the_same() -> None:
    turned = np.arange(M).reshape(S, -1)[:, ::-1].ravel()
    pair = compare_totals([totals_of(X, Y, "mpjpe"), totals_of(X[:, turned], Y[turned], "mpjpe")], ["a", "b"])
    assert abs(pair.differences[0].value) < 1e-9


def test_the_true_poses_of_each_sequence_are_compared() -> None:
    swapped = Y.copy()
    swapped[[0, -1]] = Y[[-1, 0]]  # all sums are the same but those of the first and the last sequence
    with pytest.raises(PoseDataError, match="a and b were evaluated against different true poses"):
        compare_totals([totals_of(X, Y, "mpjpe"), totals_of(X, swapped, "mpjpe")], ["a", "b"])


@pytest.mark.parametrize(
    "change",
    [
        lambda y: y + 5.0,
        lambda y: y + np.array([10.0, -10.0, 0.0]),
        lambda y: y[..., [0, 2, 1]],
        lambda y: y[:, ::-1],
    ],
    ids=["moved", "moved in two directions", "axes exchanged", "joints exchanged"],
)
def test_another_truth_is_refused(change: Any) -> None:
    with pytest.raises(PoseDataError, match="a and b were evaluated against different true poses; expected the same"):
        compare_totals([totals_of(X, Y), totals_of(X, change(Y))], ["a", "b"])


def test_true_poses_are_compared_but_for_rounding() -> None:
    one = totals_of(X, Y, "mpjpe")
    largest = np.abs(one.sums["truth"].reshape(S, -1)).max()
    assert largest > 1000

    def moved(share: float) -> Totals:
        return replace(one, sums={**one.sums, "truth": one.sums["truth"] + share * largest})

    assert compare_totals([one, moved(0.9e-4)], ["a", "b"]).names == ("a", "b")
    with pytest.raises(PoseDataError, match="a and b were evaluated against different true poses"):
        compare_totals([one, moved(1.5e-4)], ["a", "b"])


def test_true_poses_about_zero_are_compared_to_a_ten_thousandth_of_a_unit_more() -> None:
    one = totals_of(X, Y, "mpjpe")
    small = replace(one, sums={**one.sums, "truth": np.full_like(one.sums["truth"], 0.5)})

    def moved(by: float) -> Totals:
        return replace(one, sums={**one.sums, "truth": small.sums["truth"] + by})

    assert compare_totals([small, moved(1.2e-4)], ["a", "b"]).names == ("a", "b")
    with pytest.raises(PoseDataError, match="a and b were evaluated against different true poses"):
        compare_totals([small, moved(1.8e-4)], ["a", "b"])


def test_a_metric_of_one_s_own_is_the_same_for_both() -> None:
    own = [Metric.from_function(lambda x, y: x[0, :, 0, 0], name="own", definition=text) for text in ("one", "other")]
    pair = [replace(totals_of(X, Y, "mpjpe"), own_metrics=(metric,)) for metric in own]
    with pytest.raises(PoseDataError, match=r"^a and b define own differently; expected the same metrics\.$"):
        compare_totals(pair, ["a", "b"])


def test_one_model_is_nothing_to_compare() -> None:
    with pytest.raises(PoseDataError, match="compare: 1 model; expected at least 2"):
        compare_totals([totals_of(X, Y)], ["a"])


def test_models_of_the_same_name_are_numbered() -> None:
    found = compare_totals([totals_of(X, Y), totals_of(X + 1, Y)], ["run", "run"])
    assert found.names == ("run", "run #2")


def test_one_sequence_gives_a_difference_and_no_p_value() -> None:
    labels = {"sequence": np.repeat("only", M)}
    found = compare_totals([totals_of(x, Y, "mpjpe", labels) for x in (X, X + 9)], ["a", "b"]).differences[0]
    assert found.value < 0
    assert math.isnan(found.p)
    assert math.isnan(found.low)
    assert found.better is None


def test_a_number_that_is_best_at_zero_is_compared_by_its_distance_from_zero() -> None:
    """Too narrow by as much as too wide: the signed areas differ beyond chance, their sizes don't."""
    centre = X.mean(axis=0)
    found = compare_totals(
        [totals_of(centre + s * (X - centre), Y, "signed_area") for s in (0.8, 1.3)], ["narrow", "wide"]
    )
    narrow, wide = (found.value("signed_area", name) for name in found.names)
    assert narrow < -0.03
    assert wide > 0.03
    (difference,) = found.differences
    assert difference.value == pytest.approx(abs(narrow) - abs(wide))
    assert difference.better is None


def test_models_are_not_ranked_by_an_event_that_each_chooses_itself() -> None:
    """Far off and knowing it has a perfect Brier score."""
    far = compare_totals([totals_of(X, Y, "brier"), totals_of(5000.0 + 8 * X, Y, "brier")], ["right", "far"])
    assert far.value("brier", "far") < far.value("brier", "right")
    assert far.differences[0].better is None


def test_models_are_called_calibrated_by_their_own_test(three: Comparison) -> None:
    assert "narrow" not in three.calibrated()
    assert "right" in three.calibrated()


def test_a_model_that_repeats_one_hypothesis_leaves_the_others_their_test() -> None:
    point = np.repeat(X.mean(axis=0)[None], len(X), axis=0)
    alone, both = (
        compare_totals([totals_of(x, Y, "ece") for x in models], "abc") for models in ([X] * 3, [X, point, X])
    )
    assert both.calibrated() == ["a", "c"]
    assert both.feasible() == alone.feasible()


def test_at_the_level_itself_a_test_does_not_reject() -> None:
    pair = compare_totals([totals_of(X, Y, "ece"), totals_of(X + 1, Y, "ece")], ["a", "b"])
    test = pair.test("ece", "a")
    for name, p in (("a", LEVEL), ("b", LEVEL * 0.999)):
        pair._memory["null", "ece", name] = replace(test, p=p)
    assert pair.calibrated() == ["a"]


def test_what_has_no_test_is_not_called_calibrated(three: Comparison) -> None:
    for ask in (three.feasible, three.calibrated):
        with pytest.raises(PoseDataError, match=r"^test: mpjpe is no calibration error or rank test\. Known: ece, "):
            ask("mpjpe")
    few = {"sequence": sequences(M, 5)}
    pair = compare_totals([totals_of(X, Y, "ece", few), totals_of(X + 1, Y, "ece", few)], ["a", "b"])
    with pytest.raises(PoseDataError, match=r"^calibrated: ece has no test on 5 sequences; expected at least 6\.$"):
        pair.calibrated()


def test_a_form_is_one_of_a_few(three: Comparison) -> None:
    with pytest.raises(PoseDataError, match=r"^format: 5 is not known\. Known: text, csv, json, latex, markdown\.$"):
        three.render(5)  # type: ignore[arg-type]
