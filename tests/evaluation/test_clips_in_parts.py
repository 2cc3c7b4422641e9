"""Clips of predicted motion in batches, shards and merged results: told apart by name, or refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import posecal
from posecal.errors import PoseDataError
from posecal.evaluation.kept import is_kept
from tests.helpers.random_worlds import skewed
from tests.helpers.sharded import largest_difference

CLIPS, T = 6, 5
X, Y = skewed(2, 7, CLIPS * T, 4)
HYPOTHESES, TRUTH = X.reshape(7, CLIPS, T, 4, 3), Y.reshape(CLIPS, T, 4, 3)
OBSERVED = TRUTH[:, 0] + 5.0
HOW = {"unit": "mm", "axes": "NMTKD", "truth_axes": "MTKD", "metrics": "ade, fde, min_mpjpe"}


def batches(order: list[int], **options: object) -> posecal.Evaluation:
    evaluation = posecal.Evaluation(**{**HOW, **options})
    for clip in order:
        evaluation.update(HYPOTHESES[:, [clip]], TRUTH[[clip]])
    return evaluation


def test_batches_of_whole_clips_give_the_numbers_of_one_call() -> None:
    whole = posecal.evaluate(HYPOTHESES, TRUTH, **HOW)
    report = batches([*range(CLIPS)]).compute()
    for name in ("ade", "fde", "min_mpjpe"):
        assert report[name] == pytest.approx(whole[name], rel=1e-12)
        assert report.interval(name) == pytest.approx(whole.interval(name), rel=1e-9)


def test_batches_whose_clips_come_by_label_are_refused() -> None:
    evaluation = posecal.Evaluation(unit="mm", axes="NMKD", metrics="ade")
    with pytest.raises(PoseDataError, match=r"^clip: a label of poses that come in batches, which may cut"):
        evaluation.update(X[:, :3], Y[:3], clip=np.array(["a", "a", "a"]))


def test_clips_that_were_prepared_in_another_order_are_refused() -> None:
    data = posecal.PoseData(HYPOTHESES, TRUTH, observed=OBSERVED, unit="mm", axes="NMTKD", truth_axes="MTKD")
    prepared = posecal.prepare(data)
    whole = posecal.evaluate(data, metrics="mmade", protocol=None)
    options = {"metrics": "mmade", "prepared": prepared}
    assert batches([*range(CLIPS)], **options).compute()["mmade"] == pytest.approx(whole["mmade"])
    with pytest.raises(PoseDataError, match=r"clip: '0' has other true poses than the one that was prepared"):
        batches([*range(CLIPS)][::-1], **options).compute()


def test_clips_without_names_are_not_merged() -> None:
    first, second = batches([0, 1, 2]), batches([3, 4, 5])
    with pytest.raises(PoseDataError, match=r"sequences are the numbers of clips, alike in each; expected labels"):
        posecal.merge_totals([first.totals(), second.totals()])


def test_clips_of_files_that_lack_frames_have_numbers_of_their_own(tmp_path: Path) -> None:
    valid = np.ones((3 * T, 4), dtype=bool)
    valid[[0, T]] = False
    evaluation = posecal.Evaluation(metrics="ade")
    for part in (slice(0, 3), slice(3, 6)):
        np.savez(tmp_path / "gt.npz", truth=TRUTH[part], valid=valid, axes="MTKD", unit="mm")
        np.savez(tmp_path / "hyps.npz", hypotheses=HYPOTHESES[:, part], axes="NMTKD", unit="mm")
        evaluation.update(tmp_path / "hyps.npz", tmp_path / "gt.npz")
    assert evaluation.totals().cells["sequence"].tolist() == [*"012345"]


# --- windows of one recording that overlap -----------------------------------------------------------------------

RECORDING = TRUTH.reshape(CLIPS * T, 4, 3)[:12]
STARTS = np.arange(0, 8, 2)  # every second frame begins a window of 5
WINDOWS = STARTS[:, None] + np.arange(T)
OF_WINDOWS = RECORDING[WINDOWS] + np.random.default_rng(3).normal(0, 40, (7, len(STARTS), T, 4, 3))
ALL: dict[str, object] = {"by": "horizon", "metrics": "default, clip_energy_score, mpjve", "fps": 25}


def windows(*batches: list[int], names: object = WINDOWS) -> posecal.Evaluation:
    """Evaluate batches of windows whose frames, or which themselves, have names."""
    evaluation = posecal.Evaluation(**{**HOW, **ALL})
    for some in batches:
        named = {} if names is None else {"frame_id": np.asarray(names)[some]}
        evaluation.update(OF_WINDOWS[:, some], RECORDING[WINDOWS[some]], sequence="walk", **named)
    return evaluation


@pytest.mark.parametrize(
    "names", [None, WINDOWS, [f"from {start}" for start in STARTS]], ids=["no names", "of frames", "of windows"]
)
def test_a_frame_counts_in_every_window_that_holds_it(names: object) -> None:
    labels = {"sequence": ["walk"] * len(STARTS)}
    one = posecal.evaluate(OF_WINDOWS, RECORDING[WINDOWS], labels=labels, **{**HOW, **ALL})
    report = windows([0, 1], [2, 3], names=names).compute()
    assert report.totals.poses.sum() == len(STARTS) * T
    rows, difference = largest_difference(one, report)
    assert rows > 100
    assert difference < 1e-12
    assert {*report.remarks} == {*one.remarks}


@pytest.mark.parametrize("names", [WINDOWS, STARTS], ids=["of frames", "of windows"])
def test_a_window_that_a_sampler_repeats_counts_once(names: object) -> None:
    once, twice = windows([0, 1], [2, 3], names=names).compute(), windows([0, 1], [2, 3, 0], names=names).compute()
    assert largest_difference(once, twice)[1] < 1e-12
    assert "5 poses came more than once, by frame_id; each frame is counted once." in twice.remarks
    total = windows([0, 1], [3], names=names)
    total.merge(windows([2, 3], names=names))
    assert total.compute().scalars() == pytest.approx(once.scalars(), rel=1e-12)


def test_a_clip_of_which_some_frames_came_before_at_their_horizon_is_refused() -> None:
    evaluation = windows([0])
    with pytest.raises(PoseDataError, match=r"^frame_id: frames of 1 clips came before at the same horizon .*clip 0\)"):
        evaluation.update(OF_WINDOWS[:, [1]], RECORDING[WINDOWS[[1]]], frame_id=[0, 1, 2, 3, 9], sequence="walk")
    with pytest.raises(
        PoseDataError, match=r"^frame_id: \(3,\); expected one name per pose, \(5,\), or per clip, \(1,\)"
    ):
        evaluation.update(OF_WINDOWS[:, [1]], RECORDING[WINDOWS[[1]]], frame_id=[0, 1, 2], sequence="walk")


def test_windows_of_every_second_frame_stay_whole() -> None:
    every_second = np.array([[0, 2, 4, 6, 8], [1, 3, 5, 7, 9]])
    truth, labels = RECORDING[every_second], {"sequence": ["walk", "walk"]}
    names = {"frame_id": every_second.ravel(), "truth_frame_id": every_second.ravel()}
    report = posecal.evaluate(OF_WINDOWS[:, :2], truth, labels=labels, **names, **HOW)
    assert report["ade"] == pytest.approx(posecal.evaluate(OF_WINDOWS[:, :2], truth, **HOW)["ade"], rel=1e-12)


# --- results that are kept -------------------------------------------------------------------------------------


def kept_after(folder: Path, **options: object) -> set[str]:
    pairs = [(folder / f"h{k}.npz", folder / f"g{k}.npz") for k in range(2)]
    posecal.evaluate_shards(pairs, keep=folder / "kept", threads=1, metrics="ece", **options)
    return {path.name for path in (folder / "kept").iterdir()}


def test_another_function_of_the_same_name_is_evaluated_anew(tmp_path: Path) -> None:
    for k, part in enumerate((slice(0, 15), slice(15, 30))):
        about = {"unit": "mm", "frame_id": np.array([f"{k}-{m}" for m in range(15)])}
        np.savez(tmp_path / f"h{k}.npz", hypotheses=X[:, part], axes="NMKD", **about)
        np.savez(tmp_path / f"g{k}.npz", truth=Y[part], axes="MKD", **about)
    first, other = (lambda pool: pool[..., 0].max(axis=1)), (lambda pool: pool[..., 1].min(axis=1))
    once = kept_after(tmp_path, preranks={"width": first})
    assert kept_after(tmp_path, preranks={"width": first}) == once
    again = kept_after(tmp_path, preranks={"width": other})
    assert len(again) == len(once) + 2
    assert all(is_kept(Path(name)) for name in again)
    assert not is_kept(Path("hyps-1.npz"))
