"""Two models on the same poses: differences with intervals and p-values, ranks, and what can't be compared."""

from __future__ import annotations

import csv
import io
import json
import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy import stats

from posecal.engine.metric import Metric
from posecal.engine.protocol import Protocol
from posecal.engine.totals import Totals
from posecal.errors import PoseDataError, for_command_line, option
from posecal.stats import comparison
from posecal.stats.comparison import Comparison, compare_totals
from posecal.stats.jackknife import leave_one_out
from posecal.stats.resampling import LEVEL, holm
from tests.helpers.samplers import gaussian, pairs_of, sequences
from tests.helpers.sums import accumulate

Array = np.ndarray
M, S = 48, 8
LABELS = {"sequence": sequences(M, S)}
METRICS = "default, scores"


def totals_of(
    x: Array, y: Array, metrics: str = METRICS, labels: dict[str, Array] | None = None, **options: str
) -> Totals:
    protocol = Protocol().changed({"metrics": metrics, **options})
    return accumulate(pairs_of(x, y, labels=labels or LABELS), protocol, threads=1)


X, Y = gaussian(0, 12, M, 4)
MODELS = {"right": X, "narrow": X.mean(axis=0) + 0.4 * (X - X.mean(axis=0)), "off": X + 80.0}


@pytest.fixture(scope="module")
def three() -> Comparison:
    return compare_totals([totals_of(x, Y) for x in MODELS.values()], list(MODELS))


# --- differences ------------------------------------------------------------------------------------------------------


def by_hand(name: str, first: Array, second: Array) -> tuple[float, float, float, float]:
    """Difference, its interval and its p-value: each model evaluated without each sequence in turn."""
    known = compare_totals([totals_of(first, Y), totals_of(second, Y)], ["a", "b"]).metrics[name]

    def difference(poses: Array) -> float:
        labels = {"sequence": LABELS["sequence"][poses]}
        ours, theirs = (totals_of(x[:, poses], Y[poses], name, labels).value(known) for x in (first, second))
        return ours - theirs

    whole = difference(np.arange(M))
    without = np.array([difference(np.flatnonzero(LABELS["sequence"] != s)) for s in np.unique(LABELS["sequence"])])
    error = math.sqrt((S - 1) / S * ((without - without.mean()) ** 2).sum())
    reach = stats.t(S - 1).ppf(0.975) * error
    return whole, whole - reach, whole + reach, 2 * stats.t(S - 1).sf(abs(whole) / error)


@pytest.mark.parametrize("metric", ["min_mpjpe", "ece", "energy_score", "pck"])
def test_a_difference_is_left_one_sequence_out(metric: str) -> None:
    first, second = MODELS["right"], MODELS["off"]
    found = compare_totals([totals_of(first, Y), totals_of(second, Y)], ["a", "b"])
    difference = next(d for d in found.differences if d.metric == metric)
    expected = by_hand(metric, first, second)
    np.testing.assert_allclose(
        (difference.value, difference.low, difference.high, difference.p), expected, rtol=1e-6, atol=1e-12
    )


@pytest.mark.slow
def test_intervals_of_differences_cover_the_truth_as_often_as_they_say() -> None:
    times, frames, held, certain = 120, 3, 0, 0
    for time in range(times):
        random = np.random.default_rng([time, 7])
        poses = S * frames
        shared = random.normal(0, 40, (S, 1, 1, 3)).repeat(frames, axis=1).reshape(poses, 1, 3)
        y = random.normal(0, 200, (poses, 1, 3))
        one, other = (y + 0.3 * shared + random.normal(0, 30, (2, poses, 1, 3)) for _ in range(2))
        labels = {"sequence": sequences(poses, S)}
        pair = [totals_of(x, y, "mpjpe", labels) for x in (one, other)]
        found = compare_totals(pair, ["one", "other"]).differences[0]
        held += found.low <= 0 <= found.high
        certain += found.p < 0.05
    low, high = stats.binom(times, 0.95).interval(0.9999)
    assert low <= held <= high
    assert certain == times - held


def test_a_difference_is_surer_than_the_numbers_that_it_is_of() -> None:
    random = np.random.default_rng(5)
    size = np.repeat(random.lognormal(0, 0.8, S), M // S)[:, None, None]  # some sequences are far harder
    pair = compare_totals([totals_of(x * size, Y * size, "mpjpe") for x in (X, 1.2 * (X - Y) + Y)], ["one", "other"])
    difference = pair.differences[0]
    alone = pair.interval("mpjpe", "one")
    assert difference.high - difference.low < (alone.high - alone.low) / 2
    assert difference.better == "one"


def test_a_model_does_not_differ_from_itself() -> None:
    found = compare_totals([totals_of(X, Y)] * 2, ["one", "other"])
    for difference in found.differences:
        assert difference.value == 0
        assert difference.p == 1 or math.isnan(difference.p)
        assert difference.better is None


# --- which is better, and ranks ---------------------------------------------------------------------------------------


def test_the_better_model_is_the_one_in_the_metric_s_direction(three: Comparison) -> None:
    better = {(d.metric, d.first, d.second): d.better for d in three.differences}
    assert better["energy_score", "right", "off"] == "right"  # lower is better
    assert better["pck", "right", "off"] == "right"  # higher is better
    assert better["signed_area", "right", "narrow"] == "right"  # nearer to 0 is better
    assert better["coverage_50", "right", "narrow"] is None  # no direction is better
    assert three.value("coverage_50", "right") != three.value("coverage_50", "narrow")


def test_p_values_of_one_metric_are_adjusted_for_the_number_of_pairs(three: Comparison) -> None:
    names = list(MODELS)
    alone = []
    for a, b in ((0, 1), (0, 2), (1, 2)):
        pair = compare_totals([three.totals[a], three.totals[b]], [names[a], names[b]])
        alone.append(next(d.p for d in pair.differences if d.metric == "crps"))
    together = [d.p for d in three.differences if d.metric == "crps"]
    np.testing.assert_allclose(together, holm(alone), rtol=1e-12)


def test_the_rank_is_one_and_how_many_are_better_beyond_chance(three: Comparison) -> None:
    for metric in ("energy_score", "ece", "crps", "coverage_90"):
        for model in MODELS:
            beaten_by = [
                d
                for d in three.differences
                if d.metric == metric and model in (d.first, d.second) and d.better not in (None, model)
            ]
            assert three.rank(metric, model) == 1 + len(beaten_by)
    assert three.rank("energy_score", "right") == 1
    assert three.rank("energy_score", "off") > 1
    assert three.rank("coverage_90", "off") == 1  # of no direction none is better


def test_accuracy_and_calibration_are_two_axes() -> None:
    # In 48 dimensions the best of 12 is nearer to the truth for a spread that is too narrow: the paper's finding.
    x, y = gaussian(1, 12, M, 16)
    centre = x.mean(axis=0)
    pair = compare_totals([totals_of(x, y), totals_of(centre + 0.5 * (x - centre), y)], ["right", "narrow"])
    better = {d.metric: d.better for d in pair.differences}
    assert better["min_mpjpe"] == "narrow"
    assert better["ece"] == better["energy_score"] == "right"


def test_the_feasible_region_ends_where_chance_does(three: Comparison) -> None:
    limit = three.feasible()
    assert three.value("ece", "right") < limit < three.value("ece", "narrow")


def test_a_calibration_error_has_no_interval_and_a_mean_has(three: Comparison) -> None:
    assert math.isnan(three.interval("ece", "right").low)
    interval = three.interval("mpjpe", "right")
    assert interval.low < three.value("mpjpe", "right") < interval.high


# --- renderings -------------------------------------------------------------------------------------------------------


def test_json_holds_values_ranks_and_differences(three: Comparison) -> None:
    found = json.loads(three.render("json"))
    assert found["models"] == list(MODELS)
    assert found["signature"] == three.totals[0].signature
    row = next(v for v in found["values"] if (v["metric"], v["model"]) == ("mpjpe", "off"))
    assert row == {
        "metric": "mpjpe",
        "model": "off",
        "value": three.value("mpjpe", "off"),
        "rank": three.rank("mpjpe", "off"),
    }
    assert len(found["differences"]) == 3 * len(three.metrics)


def test_the_table_has_a_row_for_each_metric_and_pair(three: Comparison) -> None:
    table = three.table
    assert list(table) == ["metric", "first", "second", "value", "low", "high", "p", "better"]
    assert len(table) == 3 * len(three.metrics)
    row = table[(table.metric == "mpjpe") & (table["first"] == "right") & (table.second == "off")].iloc[0]
    (expected,) = (d for d in three.differences_of("mpjpe") if (d.first, d.second) == ("right", "off"))
    assert tuple(row)[3:7] == (expected.value, expected.low, expected.high, expected.p)
    assert row.better == "right"


def test_csv_holds_the_differences(three: Comparison) -> None:
    rows = list(csv.DictReader(io.StringIO(three.render("csv"))))
    assert len(rows) == len(three.differences)
    for row, difference in zip(rows, three.differences, strict=True):
        assert (row["metric"], row["first"], row["second"]) == (difference.metric, difference.first, difference.second)
        assert float(row["value"]) == difference.value
        assert row["better"] == (difference.better or "")


def test_markdown_and_latex_hold_a_line_for_each_difference() -> None:
    pair = compare_totals([totals_of(X, Y, "mpjpe"), totals_of(X + 9, Y, "mpjpe")], ["a", "b_c"])
    (difference,) = pair.differences
    head, _, row = pair.render("markdown").splitlines()
    assert [word.strip() for word in head.strip("|").split("|")][:4] == ["metric", "first", "second", "value"]
    assert [word.strip() for word in row.strip("|").split("|")][:3] == ["mpjpe", "a", "b_c"]
    (line,) = (line for line in pair.render("latex").splitlines() if line.startswith("mpjpe"))
    assert line.split(" & ")[:3] == ["mpjpe", "a", r"b\_c"]
    assert f"{difference.value:f}" in line
    assert "mpjpe" in str(pair)
    assert "<td>mpjpe</td>" in pair._repr_html_()


POINTS = "in 2 of 40 frames every hypothesis is one point."
OF_ALL = "the root Hip is taken."


def with_remarks(**remarks: tuple[str, ...]) -> Comparison:
    """Compare models of which the data have remarks."""
    totals = [replace(totals_of(MODELS[name], Y, "min_mpjpe,ece"), remarks=some) for name, some in remarks.items()]
    return compare_totals(totals, list(remarks))


def test_remarks_stand_after_the_names_of_their_models_and_once_where_they_are_of_all() -> None:
    found = with_remarks(right=(OF_ALL,), narrow=(POINTS, OF_ALL), off=(OF_ALL, POINTS))
    assert found.remarks == (OF_ALL, f"narrow, off: {POINTS}")
    assert found.table.attrs == {"remarks": [*found.remarks]}
    pair = with_remarks(right=(f"Pass {option('unit', 'cm')}.",), narrow=())
    assert pair.remarks == ('right: Pass unit="cm".',)
    assert json.loads(pair.render("json", words=for_command_line))["remarks"] == ["right: Pass --unit cm."]


def test_remarks_stand_in_every_form() -> None:
    found = with_remarks(right=(), narrow=(POINTS,))
    (remark,) = found.remarks
    assert json.loads(found.render("json"))["remarks"] == [remark]
    rows = list(csv.DictReader(io.StringIO(found.render("csv"))))
    assert [row["metric"] for row in rows] == ["min_mpjpe", "ece", "remark"]
    assert [value for value in rows[-1].values() if value] == ["remark", remark]
    assert found.render("markdown").startswith(f"note: {remark}\n\n| metric")
    assert found.render("latex").startswith(f"% note: {remark}\n\\begin")
    assert str(found).splitlines()[0] == f"note: {remark}"
    assert found._repr_html_().startswith(f"<p>note: {remark}</p>\n<table")


def test_another_form_metric_or_model_is_refused(three: Comparison) -> None:
    with pytest.raises(PoseDataError, match=r"^format: 'jsn' is not known\. Did you mean json\?"):
        three.render("jsn")
    with pytest.raises(PoseDataError, match=r"^mpjp is not in the comparison\. Did you mean mpjpe\?"):
        three.rank("mpjp", "right")
    for ask in (three.value, three.interval, three.rank):
        with pytest.raises(PoseDataError, match=r"^wrong is not in the comparison\. Known: right, narrow, off\."):
            ask("mpjpe", "wrong")


def test_a_comparison_says_what_it_is(three: Comparison) -> None:
    assert repr(three) == "<Comparison of right, narrow, off: M = 48, 8 sequences>"


def test_each_metric_of_each_model_is_left_one_sequence_out_once(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[str] = []

    def counting(totals: Totals, metric: Metric) -> Array:
        asked.append(metric.name)
        return leave_one_out(totals, metric)

    monkeypatch.setattr(comparison, "leave_one_out", counting)
    three = compare_totals([totals_of(x, Y, "mpjpe, signed_area") for x in MODELS.values()], list(MODELS))
    assert asked == []
    assert three.rank("mpjpe", "off") == 3
    assert asked == ["mpjpe"] * 3
    three.interval("mpjpe", "right")
    three.render("json")
    three.render("csv")
    assert sorted(asked) == ["mpjpe"] * 3 + ["signed_area"] * 3


# --- what can't be compared -------------------------------------------------------------------------------------------


def test_results_that_were_not_made_alike_are_refused_with_what_differs() -> None:
    with pytest.raises(PoseDataError, match=r"^a and b were not made alike: align similarity against rigid\. Evaluate"):
        compare_totals([totals_of(X, Y), totals_of(X, Y, align="rigid")], ["a", "b"])
    with pytest.raises(
        PoseDataError, match=r"N 12 against 5.*same options; n_hypotheses takes as many hypotheses of each"
    ):
        compare_totals([totals_of(X, Y), totals_of(X[:5], Y)], ["a", "b"])
    with pytest.raises(PoseDataError, match=r"best frame against sequence\. Evaluate both with the same options\.$"):
        compare_totals([totals_of(X, Y), totals_of(X, Y, best="sequence")], ["a", "b"])


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


def test_at_the_level_itself_a_test_does_not_reject() -> None:
    pair = compare_totals([totals_of(X, Y, "ece"), totals_of(X + 1, Y, "ece")], ["a", "b"])
    test = pair._null("ece", "a")
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
    with pytest.raises(PoseDataError, match=r"^format: 5 is not known\. Known: csv, json, latex, markdown\.$"):
        three.render(5)  # type: ignore[arg-type]
