"""Clips of predicted motion in batches, shards and merged results: told apart by name, or refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import posecal
from posecal.errors import PoseDataError
from posecal.evaluation.kept import is_kept
from tests.helpers.random_worlds import skewed

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


def test_frames_of_overlapping_clips_are_not_dropped_from_one_of_them() -> None:
    evaluation = posecal.Evaluation(**HOW)
    names = np.array([f"f{k}" for k in range(T)])
    evaluation.update(HYPOTHESES[:, [0]], TRUTH[[0]], frame_id=names)
    with pytest.raises(PoseDataError, match=r"^frame_id: frames of 1 clips came before in others"):
        evaluation.update(HYPOTHESES[:, [1]], TRUTH[[1]], frame_id=np.array(["f3", "f4", "f5", "f6", "f7"]))


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
