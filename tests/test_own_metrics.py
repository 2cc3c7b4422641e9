"""A metric of the user's own: reports, groups, joints, saved results, pickles and comparisons."""

from __future__ import annotations

import json
import math
import pickle
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

import posecal
from posecal.engine.metric import Metric
from posecal.errors import PoseDataError
from tests.helpers.own_metrics import DEPTH, RMS, ROOT, depth_error
from tests.helpers.random_worlds import World, world

Array = npt.NDArray[np.floating]


pytestmark = pytest.mark.usefixtures("nothing_stays_registered")


@pytest.fixture
def some() -> World:
    return world(4, M=40)


def errors_of(some: World) -> Array:
    """Error of each pose and joint, relative to the root, (M, K)."""
    root = some.root
    x, y = some.x - some.x[:, :, [root]], some.y - some.y[:, [root]]
    return np.abs(x - y)[..., 2].mean(axis=0)


# --- reports --------------------------------------------------------------------------------------------------


def test_its_numbers_are_those_of_its_function(some: World) -> None:
    posecal.register(DEPTH)
    report = posecal.evaluate(some.pairs, by=("action", "sequence"), threads=1)
    errors = errors_of(some)
    np.testing.assert_allclose(report["depth_error"], errors.mean(), rtol=1e-9)
    assert report.scalars()["depth_error"] == report["depth_error"]
    for k, joint in enumerate(some.joints):
        np.testing.assert_allclose(report.value("depth_error", joint=joint), errors[:, k].mean(), rtol=1e-9, atol=1e-12)
    for label, values in (("action", some.action), ("sequence", some.sequence)):
        for name in np.unique(values):
            number = report.value("depth_error", group=f"{label}={name}")
            np.testing.assert_allclose(number, errors[values == name].mean(), rtol=1e-9)


def test_a_mask_leaves_joints_out(some: World) -> None:
    posecal.register(DEPTH)
    where = np.random.default_rng(0).random(some.y.shape[:2]) < 0.8
    where[:, some.joints.index("Hip")] = True  # poses without the root are left out
    report = posecal.evaluate(some.pairs.replace(where=where), threads=1)
    of_joints = [errors_of(some)[where[:, k], k].mean() for k in range(len(some.joints))]
    np.testing.assert_allclose(report["depth_error"], np.mean(of_joints), rtol=1e-9)
    assert report.count("depth_error", joint=some.joints[0]) == where[:, 0].sum()


def test_its_interval_is_the_jackknife_s_as_of_any_other(some: World) -> None:
    """A copy of a metric of posecal's has its interval."""
    posecal.register(Metric.from_function(posecal.metrics.mpjpe, name="own_mpjpe", bounds=(0, math.inf)))
    report = posecal.evaluate(some.pairs, by="action", threads=1)
    for group in report.groups:
        assert report.value("own_mpjpe", group) == pytest.approx(report.value("mpjpe", group), rel=1e-9)
        assert report.interval("own_mpjpe", group) == pytest.approx(
            report.interval("mpjpe", group), rel=1e-6, nan_ok=True
        )


@pytest.mark.parametrize("form", ["text", "markdown", "json", "csv", "latex"])
def test_every_form_of_the_report_shows_it(form: Any, some: World) -> None:
    posecal.register(DEPTH)
    text = posecal.evaluate(some.pairs, by="action").render(form, joints=True, definitions=True)
    assert ("depth error" if form in {"text", "markdown", "latex"} else "depth_error") in text
    assert "Mean absolute error along the third axis." in " ".join(text.split())
    if form == "json":
        rows = [row for row in json.loads(text)["rows"] if row["metric"] == "depth_error"]
        assert {row["group"] for row in rows} == {None, "action=walk", "action=sit", "action=eat"}
        assert {row["joint"] for row in rows} == {None, *some.joints}
        assert all(row["low"] <= row["value"] <= row["high"] for row in rows if row["group"] is None)


def test_tables_by_group_and_by_joint_show_it_where_it_says_so(some: World) -> None:
    posecal.register(DEPTH)
    posecal.register(Metric.from_function(depth_error, name="hidden", by_joint=True, in_group_table=False))
    posecal.register(RMS)
    report = posecal.evaluate(some.pairs, by="action")
    by_group = report.render("markdown", joints=True).split("### By ")
    assert "depth error" in by_group[1]
    assert "RMS" in by_group[1]
    assert "hidden" not in by_group[1]
    assert "depth error" in by_group[2]
    assert "hidden" in by_group[2]
    assert "RMS" not in by_group[2]


def test_only_it_may_be_asked_for(some: World) -> None:
    posecal.register(DEPTH)
    posecal.register(RMS)
    report = posecal.evaluate(some.pairs, metrics=["depth_error", "mpjpe"])
    assert list(report.metrics) == ["mpjpe", "depth_error"]
    np.testing.assert_allclose(posecal.evaluate(some.pairs, metrics="rms")["rms"], report_rms(some), rtol=1e-9)


def report_rms(some: World) -> float:
    root = some.root
    offsets = some.x - some.x[:, :, [root]] - (some.y - some.y[:, [root]])
    return float(np.sqrt((offsets**2).mean()))


def test_an_average_over_groups_averages_it_too(some: World) -> None:
    posecal.register(DEPTH)
    report = posecal.evaluate(some.pairs, protocol=posecal.Protocol(average="action"), threads=1)
    errors = errors_of(some).mean(axis=1)
    expected = np.mean([errors[some.action == action].mean() for action in np.unique(some.action)])
    assert report["depth_error"] == pytest.approx(expected, rel=1e-9)
    assert report.definition("depth_error").endswith("; the mean of its values for each action")


def test_batches_give_its_number_of_one_call(some: World) -> None:
    posecal.register(DEPTH)
    evaluation = posecal.Evaluation(unit="mm", axes="NMKD", joints=some.joints)
    for part in (slice(0, 13), slice(13, 40)):
        evaluation.update(some.x[:, part], some.y[part], sequence=some.sequence[part])
    assert evaluation.compute()["depth_error"] == pytest.approx(errors_of(some).mean(), rel=1e-9)


def test_a_function_that_fails_stops_the_evaluation_with_one_message(some: World) -> None:
    def fails(hypotheses: Array, truth: Array) -> Array:
        raise ValueError("no such luck")

    posecal.register(Metric.from_function(fails))
    with pytest.raises(PoseDataError, match=r"^metric: fails fails on hypotheses \(5, 40, 8, 3\) \(ValueError: no"):
        posecal.evaluate(some.pairs, threads=1)


# --- saved results and pickles --------------------------------------------------------------------------------


def test_a_saved_mean_is_reported_without_its_function(some: World, tmp_path: Path) -> None:
    posecal.register(DEPTH)
    report = posecal.evaluate(some.pairs, by="action")
    report.save(tmp_path / "result.npz")
    posecal.unregister("depth_error")
    again = posecal.Report(posecal.load_totals(tmp_path / "result.npz"), by="action")
    assert again.render("json") == report.render("json")
    assert again.metrics["depth_error"].reading == "As MPJPE."


@pytest.mark.parametrize("metric", [RMS, ROOT], ids=["own statistic", "changed finish"])
def test_a_saved_number_that_is_no_mean_needs_its_registration(metric: Metric, some: World, tmp_path: Path) -> None:
    posecal.register(metric)
    report = posecal.evaluate(some.pairs)
    report.save(tmp_path / "result.npz")
    posecal.unregister("rms")
    totals = posecal.load_totals(tmp_path / "result.npz")
    again = posecal.Report(totals)
    assert again["mpjpe"] == report["mpjpe"]
    words = r"^metric: the functions of rms are not available here; expected it to be registered\."
    for ask in (lambda: again["rms"], lambda: again.interval("rms"), lambda: str(again), lambda: again.table):
        with pytest.raises(PoseDataError, match=words):
            ask()
    posecal.register(metric)
    assert posecal.Report(totals)["rms"] == report["rms"]
    assert posecal.Report(totals).interval("rms") == report.interval("rms")


IN_ANOTHER_PROCESS = """
import pickle, sys
from posecal.errors import PoseDataError
report, totals, evaluation, data = pickle.load(open(sys.argv[1], "rb"))
print(report["depth_error"], totals.value(report.metrics["depth_error"]), evaluation.compute()["depth_error"])
print(data.shape, data.truth.sum())
try:
    report["rms"]
except PoseDataError as error:
    print(error)
"""


@pytest.mark.slow
def test_another_process_reads_pickles_without_the_functions(some: World, tmp_path: Path) -> None:
    posecal.register(DEPTH)
    posecal.register(RMS)
    report = posecal.evaluate(some.pairs)
    evaluation = posecal.Evaluation()
    evaluation.add(some.pairs, complete=True)
    (tmp_path / "p").write_bytes(pickle.dumps((report, report.totals, evaluation, some.pairs)))
    command = [sys.executable, "-c", IN_ANOTHER_PROCESS, str(tmp_path / "p")]
    root = Path(posecal.__file__).parents[1]
    lines = subprocess.run(command, cwd=root, capture_output=True, text=True, check=True).stdout.splitlines()
    assert [float(number) for number in lines[0].split()] == [report["depth_error"]] * 3
    assert lines[1] == f"{some.pairs.shape} {some.pairs.truth.sum()}"
    assert lines[2].startswith("metric: the functions of rms are not available here")


def test_pickles_give_the_same_numbers(some: World) -> None:
    posecal.register(DEPTH)
    posecal.register(RMS)
    report = posecal.evaluate(some.pairs, by=("action", "occlusion"), threads=1)
    assert pickle.loads(pickle.dumps(report)).render("json") == report.render("json")
    totals = pickle.loads(pickle.dumps(report.totals))
    assert posecal.Report(totals, by=("action", "occlusion")).render("json") == report.render("json")
    data = pickle.loads(pickle.dumps(some.pairs))
    assert posecal.evaluate(data, by=("action", "occlusion"), threads=1).render("json") == report.render("json")


def test_an_evaluation_goes_on_after_it_was_pickled(some: World) -> None:
    posecal.register(DEPTH)
    one = posecal.Evaluation(unit="mm", axes="NMKD", joints=some.joints)
    one.update(some.x[:, :13], some.y[:13])
    two = pickle.loads(pickle.dumps(one))
    for evaluation in (one, two):
        evaluation.update(some.x[:, 13:], some.y[13:])
    assert two.compute().render("json") == one.compute().render("json")
    posecal.unregister("depth_error")
    three = pickle.loads(pickle.dumps(one))
    with pytest.raises(PoseDataError, match=r"^metric: the functions of depth_error are not available here"):
        three.compute()  # some poses were waiting for the next batch


# --- merging and comparing ------------------------------------------------------------------------------------


def test_shards_merge_with_it(some: World) -> None:
    posecal.register(RMS)
    parts = [posecal.evaluate(some.select(part).pairs).totals for part in np.split(np.arange(40), [17])]
    merged = posecal.Report(posecal.merge_totals(parts))
    assert merged["rms"] == pytest.approx(report_rms(some), rel=1e-9)
    posecal.unregister("rms")
    other = posecal.evaluate(some.select(np.arange(17, 40)).pairs).totals
    with pytest.raises(PoseDataError, match=r"result were asked for different metrics \(sums in one only: squares\)"):
        posecal.merge_totals([parts[0], other])


def test_metrics_that_are_described_otherwise_are_neither_merged_nor_compared(some: World) -> None:
    posecal.register(DEPTH)
    parts = [some.select(part).pairs for part in np.split(np.arange(40), [17])]
    whole, first = posecal.evaluate(some.pairs), posecal.evaluate(parts[0])
    posecal.register(replace(DEPTH, definition="another"), replace=True)
    again, second = posecal.evaluate(some.pairs), posecal.evaluate(parts[1])
    with pytest.raises(PoseDataError, match=r"result define depth_error differently; expected the same metrics\.$"):
        posecal.merge_totals([first.totals, second.totals])
    with pytest.raises(PoseDataError, match=r"^a and b define depth_error differently; expected the same metrics\.$"):
        posecal.compare({"a": whole, "b": again})
    assert posecal.compare({"a": again, "b": pickle.loads(pickle.dumps(again))}).metrics["depth_error"]


@pytest.mark.parametrize("metric", [DEPTH, RMS], ids=["depth", "rms"])
def test_models_are_compared_by_it(metric: Metric, some: World, tmp_path: Path) -> None:
    posecal.register(metric)
    some = replace(some, sequence=np.repeat([*"abcdefgh"], 5))
    better = (
        some.pairs,
        posecal.PoseData(
            0.9 * some.x + 0.1 * some.y,
            some.y,
            joints=some.joints,
            labels={"sequence": some.sequence},
            axes="NMKD",
            unit="mm",
        ),
    )
    reports = {name: posecal.evaluate(data) for name, data in zip(("first", "second"), better, strict=True)}
    comparison = posecal.compare(reports)
    assert comparison.value(metric.name, "second") == pytest.approx(0.9 * comparison.value(metric.name, "first"))
    difference = next(d for d in comparison.differences if d.metric == metric.name)
    assert difference.better == "second"
    assert difference.low < difference.value < difference.high
    for name, report in reports.items():
        report.save(tmp_path / f"{name}.npz")
    saved = posecal.compare({name: tmp_path / f"{name}.npz" for name in reports})
    assert saved.render("json") == comparison.render("json")
