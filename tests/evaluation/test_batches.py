"""Evaluation in batches gives the numbers of one call, keeps sums only, and refuses what does not fit."""

import math
import pickle
import tracemalloc
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

import posecal
from posecal.engine.merge import merge_totals
from posecal.engine.storage import load_totals, save_totals
from posecal.errors import PoseDataError
from posecal.report.report import Report

N, M, K = 7, 90, 5
JOINTS = ("Hip", "RHip", "RKnee", "LHip", "LKnee")

Arrays = dict[str, Any]


@pytest.fixture
def world() -> Arrays:
    """Poses of nine sequences of ten frames, with labels, a mask, scores and occlusion."""
    random = np.random.default_rng(7)
    truth = random.normal(0, 300, (M, K, 3))
    truth[:, 0] = 0
    hypotheses = truth + random.normal(0, 60, (N, M, K, 3)) * random.uniform(0.3, 1.5, (1, M, 1, 1))
    hypotheses[:, :, 0] = 0
    where = random.random((M, K)) < 0.9
    where[:, 0] = True
    return {
        "hypotheses": hypotheses.astype(np.float32),
        "truth": truth,
        "where": where,
        "occluded": random.random((M, K)) < 0.3,
        "scores": random.random((N, M)),
        "sequence": np.repeat([f"clip {s}" for s in range(9)], 10),
        "action": np.repeat(["walk", "sit", "run"], 30),
        "phase": np.tile(["a", "b"], 45),
    }


def batches(
    world: Arrays, sizes: list[int], *names: str
) -> Iterator[tuple[npt.NDArray[Any], npt.NDArray[Any], Arrays]]:
    """Cut a world into batches of these sizes, repeated."""
    start = number = 0
    while start < M:
        stop = min(start + sizes[number % len(sizes)], M)
        part = slice(start, stop)
        extra = {name: world[name][:, part] if name == "scores" else world[name][part] for name in names}
        yield world["hypotheses"][:, part], world["truth"][part], extra
        start, number = stop, number + 1


def in_batches(world: Arrays, sizes: list[int], *names: str, **options: Any) -> Report:
    evaluation = posecal.Evaluation(unit="mm", axes="NMKD", joints=JOINTS, **options)
    for hypotheses, truth, extra in batches(world, sizes, *names):
        evaluation.update(hypotheses, truth, **extra)
    return evaluation.compute()


def in_one_call(world: Arrays, *names: str, **options: Any) -> Report:
    labels = {name: world[name] for name in names if name not in {"where", "occluded", "scores"}}
    given = {name: world[name] for name in names if name in {"where", "occluded", "scores"}}
    data = posecal.PoseData(
        world["hypotheses"], world["truth"], unit="mm", axes="NMKD", joints=JOINTS, labels=labels, **given
    )
    return posecal.evaluate(data, **options)


def assert_same(one: Report, other: Report, rtol: float = 1e-12) -> None:
    assert one.signature == other.signature
    left, right = one.table, other.table
    assert left[["metric", "group", "joint", "poses"]].equals(right[["metric", "group", "joint", "poses"]])
    for column in ("value", "low", "high"):
        np.testing.assert_allclose(left[column], right[column], rtol=rtol, atol=1e-12)


@pytest.mark.parametrize("sizes", [[1], [64], [7, 20, 3], [90]])
def test_batches_of_any_length_give_the_numbers_of_one_call(world: Arrays, sizes: list[int]) -> None:
    names = ("where", "occluded", "scores", "sequence", "action", "phase")
    motion = ["mpjve", "acceleration_error", "jitter", "true_jitter"]
    options = {"by": ["action", "occlusion"], "metrics": ["default", "scores", "mode_mpjpe", *motion]}
    assert_same(in_batches(world, sizes, *names, **options), in_one_call(world, *names, **options))


def test_where_blocks_agree_the_sums_are_equal_to_the_bit(world: Arrays) -> None:
    one, other = in_one_call(world, "sequence").totals, in_batches(world, [11], "sequence").totals
    for name, sums in one.sums.items():
        np.testing.assert_array_equal(sums, other.sums[name])


@pytest.mark.parametrize("sizes", [[1], [13], [90]])
def test_without_labels_runs_do_not_depend_on_the_batches(world: Arrays, sizes: list[int]) -> None:
    assert_same(in_batches(world, sizes), in_one_call(world))


def test_many_poses_without_labels_share_few_cells() -> None:
    random = np.random.default_rng(0)
    truth = random.normal(0, 300, (1000, 3, 3))
    hypotheses = truth + random.normal(0, 50, (4, 1000, 3, 3))
    evaluation = posecal.Evaluation(unit="mm", axes="NMKD")
    for start in range(0, 1000, 50):
        evaluation.update(hypotheses[:, start : start + 50], truth[start : start + 50])
    totals = evaluation.totals()
    assert len(totals.poses) == math.ceil(1000 / 16)  # runs of 2^k poses, at most 100 of them
    assert set(totals.poses[:-1]) == {16}
    assert_same(evaluation.compute(), posecal.evaluate(hypotheses, truth, unit="mm", axes="NMKD"))


def test_a_label_that_splits_a_sequence_later_on_is_dropped(world: Arrays) -> None:
    report = in_batches(world, [10], "sequence", "phase")
    assert report.totals.labels == ("sequence",)
    assert in_batches(world, [10], "sequence", "action").totals.labels == ("sequence", "action")


def test_a_label_may_be_one_value_for_the_batch(world: Arrays) -> None:
    evaluation = posecal.Evaluation(unit="mm", axes="NMKD", joints=JOINTS)
    for hypotheses, truth, extra in batches(world, [10], "sequence"):
        evaluation.update(hypotheses, truth, sequence=extra["sequence"][0], action="walk")
    assert evaluation.compute().totals.cells["action"].tolist() == ["walk"] * 9


def test_labels_in_a_mapping_are_answered_with_the_keywords(world: Arrays) -> None:
    evaluation = posecal.Evaluation(unit="mm", axes="NMKD")
    labels: Any = {"sequence": world["sequence"], "action": "walk"}
    with pytest.raises(PoseDataError, match=r"^labels: a mapping; .* as keywords: sequence=…, action=…\.$"):
        evaluation.update(world["hypotheses"], world["truth"], labels=labels)


def test_a_mask_stands_in_the_signature(world: Arrays) -> None:
    assert "where=all,mask " in in_batches(world, [30], "where").signature
    assert "where=all " in in_batches(world, [30], "sequence").signature


def test_poses_of_sequences_of_one_frame_stay_in_their_cells(world: Arrays) -> None:
    """Of orders over poses, such as the rank correlation, a group's are those of its own poses."""
    names = np.arange(M).astype(str)
    names[1::3] = names[0::3]  # a sequence of two frames, and one of a single frame, in turn
    alone = {**world, "sequence": names}
    one = in_batches(alone, [11], "sequence", "action", by="action")
    assert sorted(set(one.totals.poses.tolist())) == [1, 2]
    np.testing.assert_array_equal(one.totals.cells["sequence"][one.totals.cell_of], names)
    for action in ("walk", "sit", "run"):
        poses = np.flatnonzero(world["action"] == action)
        part = {
            name: values[:, poses] if name == "hypotheses" else values[poses]
            for name, values in alone.items()
            if name in ("hypotheses", "truth", "sequence")
        }
        expected = in_one_call(part, "sequence")["spread_error_correlation"]
        assert one.value("spread_error_correlation", f"action={action}") == pytest.approx(expected, rel=1e-12)


def test_a_velocity_reaches_over_the_end_of_a_batch(world: Arrays) -> None:
    one = in_batches(world, [4], "sequence", metrics=["mpjve"])
    assert one["mpjve"] == pytest.approx(in_one_call(world, "sequence", metrics=["mpjve"])["mpjve"], rel=1e-12)
    assert one.table.poses[0] == M - 9


@pytest.mark.parametrize("sizes", [[1], [7, 20, 3], [90]])
def test_segments_reach_over_the_end_of_a_batch(world: Arrays, sizes: list[int]) -> None:
    """Of one call, of batches that are pickled and whose arrays are overwritten, and of the function of arrays."""
    names = ("where", "sequence", "phase")  # a label that splits sequences, so that cells are joined
    rows = {"w_mpjpe": ("first_two", "mean"), "min_wa_mpjpe": ("whole", "min")}
    protocol, given = posecal.Protocol(segment="4", metrics=[*rows]), {name: world[name] for name in names[:2]}
    arrays: Any = (world["hypotheses"], world["truth"])
    one = posecal.evaluate(
        *arrays,
        where=world["where"],
        labels={"sequence": world["sequence"]},
        unit="mm",
        axes="NMKD",
        joints=JOINTS,
        root_joint="none",
        protocol=protocol,
    )
    for name, (align, of) in rows.items():
        errors: Any = posecal.metrics.world_mpjpe(*arrays, segment=4, align=align, of=of, **given)  # type: ignore
        assert one[name] == pytest.approx(np.nanmean(errors), rel=1e-6)
    evaluation = posecal.Evaluation(unit="mm", axes="NMKD", joints=JOINTS, root_joint="none", protocol=protocol)
    for hypotheses, truth, extra in batches(world, sizes, *names):
        evaluation.update(hypotheses, truth, **extra)
        hypotheses[:], truth[:] = 0, 0  # which nobody may see
        assert evaluation.compute()["w_mpjpe"] > 0
        evaluation = pickle.loads(pickle.dumps(evaluation))
    found = evaluation.compute()
    assert found.totals.labels == ("sequence",)
    for name in rows:
        assert found[name] == pytest.approx(one[name], rel=1e-12)


def test_the_report_may_be_asked_for_between_batches(world: Arrays) -> None:
    evaluation = posecal.Evaluation(unit="mm", axes="NMKD", joints=JOINTS)
    for number, (hypotheses, truth, extra) in enumerate(batches(world, [30], "sequence"), 1):
        evaluation.update(hypotheses, truth, **extra)
        assert evaluation.compute().totals.poses.sum() == 30 * number
    assert_same(evaluation.compute(), in_one_call(world, "sequence"))
    evaluation.reset()
    with pytest.raises(PoseDataError, match=r"^evaluation: no batch so far"):
        evaluation.compute()


def test_another_layout_is_declared_once(world: Arrays) -> None:
    evaluation = posecal.Evaluation(unit="m", axes="MNKD", joints=JOINTS)
    for hypotheses, truth, extra in batches(world, [25], "sequence"):
        evaluation.update(hypotheses.swapaxes(0, 1) / 1000, truth / 1000, **extra)
    np.testing.assert_allclose(
        evaluation.compute()["min_mpjpe"], in_one_call(world, "sequence")["min_mpjpe"], rtol=1e-5
    )


# --- frames ---------------------------------------------------------------------------------------------------


def test_a_frame_that_comes_again_is_counted_once(world: Arrays) -> None:
    evaluation = posecal.Evaluation(unit="mm", axes="NMKD", joints=JOINTS)
    frames = np.arange(M).astype(str)
    for part in (slice(0, 40), slice(30, 90)):
        evaluation.update(
            world["hypotheses"][:, part], world["truth"][part], sequence=world["sequence"][part], frame_id=frames[part]
        )
    report = evaluation.compute()
    assert report.totals.poses.sum() == M
    assert any(remark.startswith("10 poses came more than once, by frame_id") for remark in report.remarks)
    np.testing.assert_allclose(report["mpjpe"], in_one_call(world, "sequence")["mpjpe"], rtol=1e-12)


def test_frame_ids_are_for_all_batches_or_for_none(world: Arrays) -> None:
    evaluation = posecal.Evaluation(unit="mm", axes="NMKD", joints=JOINTS)
    evaluation.update(world["hypotheses"][:, :9], world["truth"][:9], frame_id=np.arange(9))
    with pytest.raises(PoseDataError, match=r"^frame_id: missing in this batch"):
        evaluation.update(world["hypotheses"][:, 9:], world["truth"][9:])
    with pytest.raises(PoseDataError, match=r"^frame_id: \(3,\); expected one name per pose, \(81,\)"):
        evaluation.update(world["hypotheses"][:, 9:], world["truth"][9:], frame_id=np.arange(3))


def rank(world: Arrays, rows: npt.NDArray[np.intp], size: int = 16) -> posecal.Evaluation:
    """What one process of several evaluates: some rows, in batches."""
    evaluation = posecal.Evaluation(unit="mm", axes="NMKD", joints=JOINTS)
    for start in range(0, len(rows), size):
        part = rows[start : start + size]
        evaluation.update(
            world["hypotheses"][:, part], world["truth"][part], sequence=world["sequence"][part], frame_id=part
        )
    return evaluation


def test_processes_merge_and_padded_frames_are_counted_once(world: Arrays) -> None:
    padded = np.concatenate([np.arange(M), [0, 1]])  # as a distributed sampler pads 90 poses for four processes
    first, *others = (rank(world, padded[process::4]) for process in range(4))
    for other in others:
        first.merge(pickle.loads(pickle.dumps(other)))
    report = first.compute()
    assert report.totals.poses.sum() == M
    assert any(remark.startswith("2 poses came more than once") for remark in report.remarks)
    one = in_one_call(world, "sequence")
    for name in ("min_mpjpe", "ece", "signed_area", "energy_score" if "energy_score" in one.metrics else "pck"):
        assert report[name] == pytest.approx(one[name], rel=1e-12)
    assert report.interval("mpjpe") == pytest.approx(one.interval("mpjpe"), rel=1e-10)
    assert report.test("ece").p == one.test("ece").p


def test_frames_of_earlier_batches_that_both_have_are_refused(world: Arrays, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("posecal.engine.block.BLOCK_BYTES", 4000)  # blocks of nine poses
    first, second = rank(world, np.arange(0, 60)), rank(world, np.arange(10, 90))
    before = first.totals().poses.sum()
    with pytest.raises(PoseDataError, match=r"^merge: 35 frames are in both \(10, 11, 12 and 32 more\)"):
        first.merge(second)
    assert first.totals().poses.sum() == before


def test_a_frame_of_the_last_batch_of_either_is_dropped_there(world: Arrays, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("posecal.engine.block.BLOCK_BYTES", 4000)  # blocks of nine poses
    first, second = np.append(np.arange(40, 90), 3), np.arange(40)
    for rows in ((first, second), (second, first)):
        one, other = (rank(world, some) for some in rows)
        one.merge(other)
        report = one.compute()
        assert report.totals.poses.sum() == M
        assert "1 pose came more than once, by frame_id; each frame is counted once." in report.remarks
        assert report["min_mpjpe"] == pytest.approx(in_one_call(world, "sequence")["min_mpjpe"], rel=1e-12)
        assert other.totals().poses.sum() == len(rows[1])  # stays as it is


def test_an_evaluation_without_batches_adds_nothing(world: Arrays) -> None:
    for merged, other in (
        (rank(world, np.arange(M)), posecal.Evaluation()),
        (posecal.Evaluation(), rank(world, np.arange(M))),
    ):
        merged.merge(other)
        assert_same(merged.compute(), in_one_call(world, "sequence"))


def test_a_process_of_which_all_frames_are_known_adds_nothing(world: Arrays) -> None:
    first, second = rank(world, np.arange(M)), rank(world, np.arange(20))
    first.merge(second)
    report = first.compute()
    assert report.totals.poses.sum() == M
    assert any(remark.startswith("20 poses came more than once") for remark in report.remarks)


def test_evaluations_that_were_not_made_alike_do_not_merge(world: Arrays) -> None:
    first, second = rank(world, np.arange(0, 40)), posecal.Evaluation(unit="mm", axes="NMKD")
    second.update(world["hypotheses"][:5, 40:], world["truth"][40:])
    with pytest.raises(PoseDataError, match=r"not made alike: N 7 against 5"):
        first.merge(second)
    assert first.compute().totals.poses.sum() == 40
    with pytest.raises(PoseDataError, match=r"^merge: int; expected an Evaluation"):
        first.merge(3)  # type: ignore[arg-type]


# --- refusals -------------------------------------------------------------------------------------------------


def test_a_batch_that_is_refused_is_not_counted(world: Arrays) -> None:
    evaluation = posecal.Evaluation(unit="mm", axes="NMKD", joints=JOINTS)
    evaluation.update(world["hypotheses"][:, :50], world["truth"][:50])
    broken = world["hypotheses"][:, 50:].copy()
    broken[2, 3, 1, 0] = np.nan
    with pytest.raises(
        PoseDataError, match=r"hypotheses has non-finite coordinates in 1 of 40 frames \(first: frame 3"
    ):
        evaluation.update(broken, world["truth"][50:])
    with pytest.raises(PoseDataError, match=r"^batch 2: n_hypotheses 6 against 7; expected the same in every batch"):
        evaluation.update(world["hypotheses"][:6, 50:], world["truth"][50:])
    with pytest.raises(PoseDataError, match=r"^batch 2: labels \('sequence',\) against \(\)"):
        evaluation.update(world["hypotheses"][:, 50:], world["truth"][50:], sequence="clip")
    evaluation.update(world["hypotheses"][:, 50:], world["truth"][50:])
    assert_same(evaluation.compute(), in_one_call(world))


def test_what_depends_on_all_poses_is_prepared_or_refused(world: Arrays) -> None:
    with pytest.raises(PoseDataError, match=r"^metrics: tarp_box depends on all true poses"):
        in_batches(world, [30], "sequence", metrics="rank_tests")
    with pytest.raises(PoseDataError, match=r"^by: 'predicted_spread' needs all poses before the first batch"):
        in_batches(world, [30], "sequence", by="predicted_spread")
    data = posecal.PoseData(
        world["hypotheses"],
        world["truth"],
        unit="mm",
        axes="NMKD",
        joints=JOINTS,
        labels={"sequence": world["sequence"]},
    )
    report = in_batches(world, [30], "sequence", metrics="rank_tests", prepared=posecal.prepare(data))
    assert_same(report, in_one_call(world, "sequence", metrics="rank_tests"))
    poses = posecal.prepare(
        posecal.PoseData(world["hypotheses"], world["truth"], unit="mm", axes="NMKD", joints=JOINTS)
    )
    for sizes in ([30], [7, 40]):  # without sequences each pose is one by itself
        sums = in_batches(world, sizes, metrics="tarp_box", prepared=poses).totals.sums["tarp_box"]
        np.testing.assert_allclose(sums, in_one_call(world, metrics="tarp_box").totals.sums["tarp_box"], rtol=1e-12)
    cut = "predicted_spread=50"
    assert_same(in_batches(world, [30], "sequence", by=cut), in_one_call(world, "sequence", by=cut))


def test_metrics_that_no_data_could_have_are_refused_before_the_first_batch() -> None:
    with pytest.raises(PoseDataError, match=r"^metrics: mpjp not known\. Did you mean mpjpe\?"):
        posecal.Evaluation(metrics=["mpjp"])
    with pytest.raises(PoseDataError, match=r"^protocol: int; expected a Protocol or the name of a preset"):
        posecal.Evaluation(protocol=3)  # type: ignore[arg-type]


@pytest.mark.slow
def test_memory_does_not_grow_with_the_number_of_batches() -> None:
    random = np.random.default_rng(0)
    truth = random.normal(0, 300, (64, 16, 3)).astype(np.float32)
    hypotheses = truth + random.normal(0, 50, (10, 64, 16, 3)).astype(np.float32)
    evaluation = posecal.Evaluation(unit="mm", axes="NMKD", threads=1)

    def held_after(batches: int) -> int:
        for _ in range(batches):
            evaluation.update(hypotheses, truth)
        return tracemalloc.get_traced_memory()[0]

    tracemalloc.start()
    try:
        few, many = held_after(20), held_after(100)
    finally:
        tracemalloc.stop()
    assert many - few < 100 * 64 * 32 + 500_000  # two numbers and a cell a pose; the sums of a pose take 8,000 bytes


def test_only_pose_data_are_added_and_prepared() -> None:
    for take in (posecal.Evaluation().add, posecal.prepare):
        with pytest.raises(PoseDataError, match=r"^data: ndarray; expected PoseData\.$"):
            take(np.zeros((2, 3, 4, 3)))


# --- remarks --------------------------------------------------------------------------------------------------


def test_counts_of_remarks_add_up_over_batches_and_shards(world: Arrays, tmp_path: Path) -> None:
    """Five poses lose their root: two of the first batch, and all three of the second, of which nothing is left."""
    hypotheses, truth = world["hypotheses"], world["truth"]
    where = np.ones(truth.shape[:2], dtype=bool)
    where[[3, 7, 10, 11, 12], 0] = False
    made: dict[str, Any] = {"joints": JOINTS, "axes": "NMKD", "unit": "mm"}
    parts = [slice(0, 10), slice(10, 13), slice(13, 40)]
    together = posecal.Evaluation(**made)
    for part in parts:
        together.update(hypotheses[:, part], truth[part], where=where[part])
    said = "the root Hip does not count in 5 of 40 frames (first: 3, 7): left out, since their positions are relative"
    assert [remark.startswith(said) for remark in together.totals().remarks].count(True) == 1
    assert sum("root Hip" in remark for remark in together.compute().remarks) == 1

    shards = [posecal.Evaluation(**made) for _ in parts]
    for shard, part in zip(shards, parts, strict=True):
        shard.update(hypotheses[:, part], truth[part], where=where[part])
    save_totals(shards[0].totals(), tmp_path / "a.npz")
    save_totals(shards[2].totals(), tmp_path / "c.npz")
    merged = merge_totals([load_totals(tmp_path / name) for name in ("a.npz", "c.npz")])
    assert any("does not count in 2 of 37 frames (first: 3, 7)" in remark for remark in merged.remarks)
    shards[0].merge(shards[1])
    shards[0].merge(pickle.loads(pickle.dumps(shards[2])))
    assert any(remark.startswith(said) for remark in shards[0].totals().remarks)
    assert any(remark.startswith(said) for remark in pickle.loads(pickle.dumps(shards[0].totals())).remarks)


def test_remarks_with_numbers_of_the_batch_stand_once(world: Arrays) -> None:
    """Such as that bones are too long, which they are by another factor in each batch."""
    evaluation = posecal.Evaluation(axes="NMKD", unit="mm", joints=JOINTS)
    for start in range(0, 90, 10):
        part, factor = slice(start, start + 10), 5 + start
        evaluation.update(factor * world["hypotheses"][:, part], factor * world["truth"][part])
    (bones,) = [remark for remark in evaluation.totals().remarks if "median bone" in remark]
    assert bones.startswith("the median bone of truth is 2,")
