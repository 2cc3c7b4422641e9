"""Shards that were evaluated apart, or with what was found from all poses, against one run."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import posecal
from posecal import Evaluation, Metric, PoseData, Report, evaluate, prepare
from posecal.engine.merge import merge_totals
from posecal.engine.storage import load_totals, save_totals
from posecal.engine.totals import Totals
from posecal.errors import PoseDataError
from posecal.stats.skill import climatology

NAMES = np.repeat(["a", "b", "c", "d", "e", "f"], 8)
SHARDS = [np.isin(NAMES, shard) for shard in (("a", "b"), ("c", "d"), ("e", "f"))]
OPTIONS = {"unit": "mm", "metrics": "default, rank_tests"}


def arrays() -> tuple[np.ndarray, np.ndarray]:
    random = np.random.default_rng(0)
    scale = random.lognormal(0, 0.5, (48, 1, 1))
    y = random.normal(0, 300, (48, 5, 3))
    return y + scale * random.normal(0, 60, (7, 48, 5, 3)), y + scale * random.normal(0, 60, (48, 5, 3))


def parts(**options: Any) -> list[Totals]:
    """Three shards, each evaluated by itself."""
    x, y = arrays()
    each = [(x[:, own], y[own], {"sequence": NAMES[own]}) for own in SHARDS]
    return [evaluate(h, t, labels=labels, **{**OPTIONS, **options}).totals for h, t, labels in each]


def one_run(**options: Any) -> Report:
    x, y = arrays()
    return evaluate(x, y, labels={"sequence": NAMES}, **{**OPTIONS, **options})


def assert_alike(some: Report, other: Report) -> None:
    np.testing.assert_equal([*some.metrics], [*other.metrics])
    for row, expected in zip(some.rows, other.rows, strict=True):
        name = f"{row.metric} {row.group} {row.joint}"
        assert (row.metric, row.group, row.joint, row.definition) == (
            *(expected.metric, expected.group, expected.joint, expected.definition),
        )
        found, right = ([r.value, r.low, r.high] for r in (row, expected))
        np.testing.assert_allclose(found, right, rtol=1e-7, atol=1e-9, err_msg=name)


def test_shards_with_one_coordinate_range_are_one_run() -> None:
    x, y = arrays()
    whole = PoseData(x, y, labels={"sequence": NAMES}, unit="mm")
    evaluations = [Evaluation(axes="NMKD", prepared=prepare(whole), **OPTIONS) for _ in SHARDS]
    for evaluation, own in zip(evaluations, SHARDS, strict=True):
        evaluation.update(x[:, own], y[own], sequence=NAMES[own])
    merged = Report(merge_totals([evaluation.totals() for evaluation in evaluations]))
    assert "tarp_box" in merged.metrics
    assert merged.signature == one_run().signature
    assert_alike(merged, one_run())
    evaluations[0].merge(evaluations[1])
    evaluations[0].merge(evaluations[2])
    assert_alike(evaluations[0].compute(), one_run())


def test_the_coordinate_range_of_one_run_is_that_of_all_poses() -> None:
    x, y = arrays()
    whole = PoseData(x, y, labels={"sequence": NAMES}, unit="mm")
    assert one_run().totals.prepared_hashes == {"coordinate range": prepare(whole).hash}
    moved = PoseData(x, y + 0.001, labels={"sequence": NAMES}, unit="mm")
    renamed = PoseData(x, y, labels={"sequence": np.char.add("s", NAMES)}, unit="mm")
    assert len({prepare(some).hash for some in (whole, moved, renamed)}) == 3


def test_shards_that_each_had_their_own_coordinate_range_have_no_tarp_box() -> None:
    whole, merged = one_run(), Report(merge_totals(parts()))
    assert whole.metrics.keys() - merged.metrics.keys() == {"tarp_box"}
    (remark,) = (remark for remark in merged.remarks if "tarp_box" in remark)
    assert remark.startswith("tarp_box is left out: each of these results has it by the coordinate range of its own")
    assert "Evaluation(prepared=" in remark
    assert "apart=coordinate_range" in merged.signature
    assert "apart" not in whole.signature
    for name in merged.metrics.keys() - {metric for metric in merged.metrics if "rank" in metric}:
        np.testing.assert_allclose(merged[name], whole[name], rtol=1e-9, err_msg=name)
    assert "TARP about a random point" not in str(merged)


def test_what_is_left_out_stays_so_as_more_is_merged(tmp_path: Any) -> None:
    first, second, third = parts()
    some = merge_totals([first, second])
    save_totals(some, tmp_path / "some.npz")
    loaded = load_totals(tmp_path / "some.npz")
    assert (
        (loaded.spec.apart, loaded.prepared_hashes)
        == (some.spec.apart, some.prepared_hashes)
        == (("coordinate range",), {})
    )
    for order in ([loaded, third], [third, loaded]):
        merged = merge_totals(order)
        assert merged.signature == merge_totals([first, second, third]).signature
        assert sum("tarp_box" in remark for remark in merged.remarks) == 1
    assert merge_totals([loaded]).remarks == some.remarks


def test_results_that_do_not_say_what_they_found_are_taken_to_differ(tmp_path: Any) -> None:
    """As those of posecal 0.1.0."""
    some = parts()
    for totals in some:
        totals.prepared_hashes = {}
    assert merge_totals(some).spec.apart == ("coordinate range",)
    assert "tarp_box" in Report(merge_totals(some[:1])).metrics
    assert merge_totals(parts(metrics="default")).spec.apart == ()


def test_a_metric_asked_for_by_name_is_left_out_and_the_others_stay() -> None:
    merged = Report(merge_totals(parts(metrics="mpjpe, tarp_box")))
    assert [*merged.metrics] == ["mpjpe"]
    with pytest.raises(PoseDataError, match=r"^merge: no other metrics\. tarp_box is left out: each of these results"):
        merge_totals(parts(metrics="tarp_box"))


def test_skills_against_a_climatology_of_each_shard_are_left_out() -> None:
    options = {"metrics": "scores", "reference": "climatology"}
    whole, merged = one_run(**options), Report(merge_totals(parts(**options)))
    lost = {"energy_skill", "joint_energy_skill", "crps_skill", "variogram_skill", "brier_skill"}
    assert whole.metrics.keys() - merged.metrics.keys() == lost
    (remark,) = (remark for remark in merged.remarks if "climatology" in remark)
    assert remark.startswith("skills are left out: each of these results has the climatology of its own poses.")
    assert "apart=climatology" in merged.signature
    for name in merged.metrics:
        np.testing.assert_allclose(merged[name], whole[name], rtol=1e-9, err_msg=name)


def test_skills_against_one_climatology_or_one_model_add() -> None:
    x, y = arrays()
    whole = PoseData(x, y, labels={"sequence": NAMES}, unit="mm")
    for reference in (climatology(whole), whole.replace(hypotheses=PoseData(x[:, ::-1], y, unit="mm").hypotheses)):
        each = [np.flatnonzero(own) for own in SHARDS]
        options = {"metrics": "scores"}
        totals = [evaluate(whole.select(m), reference=reference.select(m), **options).totals for m in each]
        assert_alike(Report(merge_totals(totals)), evaluate(whole, reference=reference, **options))


def test_own_metrics_whose_names_end_alike_stay() -> None:

    def own_skill(hypotheses: np.ndarray, truth: np.ndarray) -> np.ndarray:
        return np.abs(hypotheses - truth).mean(axis=(0, 2, 3))

    posecal.register(Metric.from_function(own_skill))
    try:
        options = {"metrics": "own_skill, energy_skill", "reference": "climatology"}
        assert [*Report(merge_totals(parts(**options))).metrics] == ["own_skill"]
    finally:
        posecal.unregister("own_skill")


@pytest.mark.parametrize("by", ["predicted_spread", "predicted_spread:2"])
def test_groups_by_equal_parts_of_the_spread_of_each_shard_are_left_out(by: str) -> None:
    totals = parts(by=by, metrics="default")
    merged = merge_totals(totals)
    assert by not in merged.labels
    (remark,) = (remark for remark in merged.remarks if "predicted_spread" in remark)
    assert remark.startswith(f"groups by {by} are left out: each of these results cut its own poses.")
    assert 'by="predicted_spread=40,60"' in remark
    with pytest.raises(PoseDataError, match=rf"^by: '{by}' is not a label of these poses"):
        Report(merged, by)
    whole = one_run(metrics="default")
    for name in whole.metrics:
        np.testing.assert_allclose(Report(merged)[name], whole[name], rtol=1e-9, err_msg=name)


def test_groups_by_cuts_in_mm_are_those_of_one_run() -> None:
    by = "predicted_spread=40,60"
    merged, whole = Report(merge_totals(parts(by=by, metrics="default")), by), one_run(by=by, metrics="default")
    assert [*merged.groups] == [*whole.groups]
    for group in whole.groups:
        np.testing.assert_allclose(merged.value("mpjpe", group), whole.value("mpjpe", group), rtol=1e-9)
