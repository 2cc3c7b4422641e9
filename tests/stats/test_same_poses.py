"""Metrics that count other poses of each model are not compared: a model must not win by giving up its spread."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import posecal
from posecal.registry import metrics_of
from posecal.report.comparison import Comparison, compare_totals, comparison_sheet
from posecal.stats.same_poses import poses_that_count
from tests.helpers.comparisons import LABELS, M, S, X, Y, totals_of

N = len(X)
OF_SPREAD = ("energy_score", "ece", "crps", "aurc")
REMARK = "not compared, since they count other poses of each model: "


@pytest.fixture(scope="module")
def gives_up() -> Comparison:
    """A model whose weight lies on one hypothesis of the poses with the largest scores, against the same without."""
    score = posecal.metrics.energy_score(X, Y)
    hard = score > np.quantile(score, 0.7)
    weights = np.full((N, M), 1 / N)
    weights[:, hard] = np.eye(N)[0][:, None]
    about = {"unit": "mm", "root_joint": "none", "labels": LABELS}
    models = {"one": posecal.PoseData(X, Y, weights=weights, **about), "plain": posecal.PoseData(X, Y, **about)}
    return posecal.compare(models, metrics=[*OF_SPREAD, "mpjpe"], threads=1)


def test_a_model_that_gives_up_its_spread_on_hard_poses_is_not_better(gives_up: Comparison) -> None:
    known = M - int(0.3 * M + 1)
    for name in OF_SPREAD:
        (found,) = gives_up.differences_of(name)
        assert gives_up.value(name, "one") < gives_up.value(name, "plain") or name == "ece"
        assert np.isnan([found.value, found.low, found.high, found.p, found.p_adjusted]).all()
        assert found.better is None
        assert gives_up.rank(name, "plain") == gives_up.rank(name, "one") == 1
    (said,) = (remark for remark in gives_up.remarks if remark.startswith("not compared"))
    listed, counts = said.removeprefix(REMARK).split(" (", 1)
    assert set(listed.split(", ")) == set(OF_SPREAD)
    assert counts.startswith(f"{known} of one, {M} of plain). A pose whose weight lies on one")
    (accuracy,) = gives_up.differences_of("mpjpe")
    assert np.isfinite([accuracy.value, accuracy.low, accuracy.p]).all()
    assert "energy score: not compared." in [one.lower() for one in comparison_sheet(gives_up).sentences]


def counted_less(name: str) -> Comparison:
    """Three models, of which the second lacks a pose of one statistic in the first sequence."""
    totals = [totals_of(x, Y, "default, scores") for x in (X, X + 1, X + 2)]
    fewer = totals[1].counts[name].copy()
    fewer[0] -= 1
    totals[1] = replace(totals[1], counts=totals[1].counts | {name: fewer})
    return compare_totals(totals, ["a", "b", "c"])


def test_models_that_count_the_same_poses_are_compared_beside_one_that_does_not() -> None:
    found = counted_less("crps")
    values = [difference.value for difference in found.differences_of("crps")]
    assert np.isnan(values).tolist() == [True, False, True]
    assert f"crps ({M} of a, {M - 1} of b, {M} of c)" in " ".join(found.remarks)


def test_the_number_of_poses_is_that_of_the_joint_where_models_differ_most() -> None:
    models = {name: totals_of(x, Y, "crps") for name, x in (("a", X), ("b", X + 1))}
    (statistic,) = {metric.statistic for metric in metrics_of(models["a"].protocol, models["a"].spec).values()}
    K = len(models["a"].spec.joints)
    for name, lacking in (("a", 0), ("b", 3)):
        counts = np.repeat(models[name].counts[statistic.name].reshape(S, -1)[:, :1], K, axis=1)
        counts[0, 0] -= 1
        counts[1, 1] -= lacking
        models[name] = replace(models[name], counts={**models[name].counts, statistic.name: counts})
    found = poses_that_count(models, statistic)
    assert found.numbers == {"a": M, "b": M - 3}
    assert not found.alike("a", "b")


def test_values_per_pose_are_counted_in_each_sequence() -> None:
    totals = [totals_of(x, Y, "aurc, mpjpe") for x in (X, X + 1)]
    (name,) = totals[0].per_pose
    for model, sequence in enumerate((0, S - 1)):  # as many poses of each, in other sequences
        some = totals[model].per_pose[name].copy()
        some[sequence * M // S] = np.nan
        totals[model] = replace(totals[model], per_pose={name: some})
    found = compare_totals(totals, ["a", "b"])
    assert np.isnan([difference.value for difference in found.differences]).tolist() == [False, True]
    assert f"aurc ({M - 1} of a, {M - 1} of b)" in " ".join(found.remarks)


@pytest.mark.slow
def test_of_models_with_a_spread_every_metric_is_compared() -> None:
    pair = [totals_of(x, Y, "all") for x in (X, X.mean(axis=0) + 0.4 * (X - X.mean(axis=0)))]
    assert not any(remark.startswith("not compared") for remark in compare_totals(pair, ["a", "b"]).remarks)


def test_a_metric_without_a_value_is_said_to_have_none() -> None:
    totals = [totals_of(x, Y, "failure_auroc, mpjpe") for x in (X, X + 1)]
    comparison = compare_totals(totals, ["a", "b"], ["failure_auroc"])
    assert np.isnan([comparison.value("failure_auroc", name) for name in "ab"]).all()  # no pose fails
    sheet = comparison_sheet(comparison)
    (row,) = sheet.tables[0].rows
    assert row[-5] == "–"
    label = comparison.metrics["failure_auroc"].label
    assert f"{label}: no value." in sheet.sentences
