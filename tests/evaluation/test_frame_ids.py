"""Frames that come again are counted once, by their ids, also over processes."""

import pickle

import numpy as np
import numpy.typing as npt
import pytest

import posecal
from posecal.errors import PoseDataError
from tests.helpers.batches import JOINTS, Arrays, M, assert_same, in_one_call


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
