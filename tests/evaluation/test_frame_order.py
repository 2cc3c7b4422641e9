"""Differences over time follow the numbers of frames, whatever the order of rows and batches."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

import posecal
from posecal.errors import PoseDataError

N, K = 3, 4
SEQUENCE = np.repeat(["run", "walk"], 10)
FRAME = np.tile(np.arange(10), 2)
OPTIONS: dict[str, Any] = {"unit": "mm", "axes": "NMKD", "root_joint": "none", "metrics": "mpjve"}

random = np.random.default_rng(0)
TRUTH = np.cumsum(random.normal(0, 9, (20, K, 3)), axis=0)
HYPOTHESES = TRUTH + np.cumsum(random.normal(0, 6, (N, 20, K, 3)), axis=1)

Rows = npt.NDArray[np.intp]


def expected(rows: Rows, step: int = 1) -> float:
    """MPJVE by a loop over all pairs of frames."""
    errors = HYPOTHESES - TRUTH
    changes = [
        np.linalg.norm(errors[:, late] - errors[:, early], axis=-1).mean()
        for early in rows
        for late in rows
        if SEQUENCE[early] == SEQUENCE[late] and FRAME[late] - FRAME[early] == step
    ]
    return float(np.mean(changes))


def evaluated(rows: Rows, **options: Any) -> posecal.Report:
    labels = {"sequence": SEQUENCE[rows]}
    return posecal.evaluate(HYPOTHESES[:, rows], TRUTH[rows], labels=labels, **OPTIONS, **options)


def in_batches(rows: Rows, size: int, names: Any = None) -> posecal.Evaluation:
    evaluation = posecal.Evaluation(**OPTIONS)
    for start in range(0, len(rows), size):
        part = rows[start : start + size]
        named = {} if names is None else {"frame_id": [names(row) for row in part]}
        evaluation.update(HYPOTHESES[:, part], TRUTH[part], sequence=SEQUENCE[part], **named)
    return evaluation


def said(report: posecal.Report) -> list[str]:
    words = "frame numbers", "mpjve: no value", "2 sequences lie"
    return [remark for remark in report.remarks if remark.startswith(words)]


def camera(row: int) -> str:
    return f"{SEQUENCE[row]}_{FRAME[row]:04}_cam1"


@pytest.mark.parametrize(
    "rows",
    [
        np.arange(20),
        np.random.default_rng(1).permutation(20),
        np.arange(20).reshape(2, 10).T.ravel(),
        np.delete(np.arange(20), [3, 8, 9, 14]),
    ],
)
def test_one_call_follows_the_numbers(rows: Rows) -> None:
    report = evaluated(rows, frame_id=[camera(row) for row in rows])
    assert (report["mpjve"], said(report)) == (pytest.approx(expected(rows), rel=1e-12), [])


def test_clips_one_frame_each_without_numbers_have_no_velocity_and_a_line_says_why() -> None:
    report = evaluated(np.arange(20).reshape(2, 10).T.ravel())
    assert np.isnan(report["mpjve"])
    assert said(report) == [
        "mpjve: no value, because no frame comes right after another of its sequence; expected the frames of each "
        "sequence one after another, or a frame_id with their numbers."
    ]
    one_each = posecal.evaluate(HYPOTHESES, TRUTH, labels={"sequence": np.arange(20)}, **OPTIONS)
    assert said(one_each) == ["mpjve: no value, because no 2 frames follow one another in a sequence."]


@pytest.mark.parametrize("size", [1, 3, 20])
@pytest.mark.parametrize("lacking", [[], [3, 8, 9, 14]])
def test_batches_follow_the_numbers(size: int, lacking: list[int]) -> None:
    rows = np.delete(np.arange(20), lacking)
    report = in_batches(rows, size, camera).compute()
    assert (report["mpjve"], said(report)) == (pytest.approx(expected(rows), rel=1e-12), [])


def test_batches_without_numbers_follow_their_rows() -> None:
    assert in_batches(np.arange(20), 3).compute()["mpjve"] == pytest.approx(expected(np.arange(20)), rel=1e-12)
    named = in_batches(np.arange(20), 3, lambda row: "abcdefghijklmnopqrst"[row]).compute()
    assert named["mpjve"] == pytest.approx(expected(np.arange(20)), rel=1e-12)


def test_a_sequence_at_half_the_rate_has_steps_of_its_own() -> None:
    rows = np.array([*range(10), *range(10, 20, 2)])
    report = evaluated(rows, frame_id=[camera(row) for row in rows])
    steps = 9 * expected(np.arange(10)), 4 * expected(rows[10:], step=2)
    assert report["mpjve"] == pytest.approx(sum(steps) / 13, rel=1e-12)
    assert said(report) == ["frame numbers are 2 apart in walk: velocities are of steps of so many frames."]


def test_strided_shards_remark_on_their_steps_and_on_the_sequences_that_they_cut() -> None:
    first, second = (in_batches(np.arange(start, 20, 2), 3, camera) for start in (0, 1))
    first.merge(second)
    report = first.compute()
    steps = [expected(np.arange(start, 20, 2), step=2) for start in (0, 1)]
    assert report["mpjve"] == pytest.approx(np.mean(steps), rel=1e-12)
    assert said(report) == [
        "frame numbers are 2 apart: velocities are of steps of so many frames.",
        "2 sequences lie in several results (first: run, walk): no difference over time and no segment reaches over a "
        "cut.",
    ]


def test_the_ids_of_a_file_and_those_of_its_batch_are_the_same(tmp_path: Path) -> None:
    rows = np.random.default_rng(1).permutation(20)
    names = np.array([camera(row) for row in rows])
    shared = {"unit": "mm", "frame_id": names}
    np.savez(tmp_path / "hyps.npz", hypotheses=HYPOTHESES[:, rows], **shared)
    np.savez(tmp_path / "gt.npz", truth=TRUTH[rows], sequence=SEQUENCE[rows], **shared)
    files = str(tmp_path / "hyps.npz"), str(tmp_path / "gt.npz")
    evaluation = posecal.Evaluation(root_joint="none", metrics="mpjve")
    with pytest.raises(PoseDataError, match=r"^frame_id: others than those in gt\.npz; expected one of the two\.$"):
        evaluation.update(*files, frame_id=np.char.add("x", names))
    evaluation.update(*files, frame_id=names)
    assert evaluation.compute()["mpjve"] == pytest.approx(expected(np.arange(20)), rel=1e-12)
