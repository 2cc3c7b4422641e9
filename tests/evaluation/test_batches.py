"""Evaluation in batches gives the numbers of one call, keeps sums only, and refuses what does not fit."""

import math
import pickle
import tracemalloc
from typing import Any

import numpy as np
import pytest

import posecal
from posecal.errors import PoseDataError
from tests.helpers.batches import JOINTS, Arrays, M, assert_same, batches, in_batches, in_one_call


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


def test_sums_that_were_given_stay_as_they_are() -> None:
    random = np.random.default_rng(0)
    truth = random.normal(0, 300, (4096, 3, 3)).astype("f4")  # several blocks, so that none of these poses is pending
    evaluation = posecal.Evaluation(unit="mm", axes="NMKD", metrics="mpjpe, ece")
    hypotheses = truth + random.normal(0, 50, (3, 4096, 3, 3)).astype("f4")
    evaluation.update(hypotheses, truth, sequence="one")
    first = evaluation.totals()
    before = {name: sums.copy() for name, sums in first.sums.items()}
    for _ in range(2):
        evaluation.update(hypotheses + 20, truth + 1, sequence="one")
    for name, sums in before.items():
        np.testing.assert_array_equal(first.sums[name], sums)
    assert first.poses.tolist() == [4096]
    assert evaluation.totals().poses.tolist() == [3 * 4096]


def test_another_layout_is_declared_once(world: Arrays) -> None:
    evaluation = posecal.Evaluation(unit="m", axes="MNKD", joints=JOINTS)
    for hypotheses, truth, extra in batches(world, [25], "sequence"):
        evaluation.update(hypotheses.swapaxes(0, 1) / 1000, truth / 1000, **extra)
    np.testing.assert_allclose(
        evaluation.compute()["min_mpjpe"], in_one_call(world, "sequence")["min_mpjpe"], rtol=1e-5
    )


# --- refusals -------------------------------------------------------------------------------------------------


def test_a_batch_that_is_refused_is_not_counted(world: Arrays) -> None:
    evaluation = posecal.Evaluation(unit="mm", axes="NMKD", joints=JOINTS)
    evaluation.update(world["hypotheses"][:, :50], world["truth"][:50])
    broken = world["hypotheses"][:, 50:].copy()
    broken[2, 3, 1, 0] = np.nan
    with pytest.raises(
        PoseDataError, match=r"hypotheses has non-finite coordinates in 1 of 40 frames \(first: frame 53"
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
