"""Clips are declared once, by a T of the layout or a label, and give labels of sequences and horizons."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from posecal import PoseData
from posecal.errors import PoseDataError

HYPOTHESES = np.arange(2 * 3 * 5 * 4 * 3, dtype=float).reshape(2, 3, 5, 4, 3) * 10
TRUTH = HYPOTHESES[0] + 7.0
OPTIONS = {"unit": "mm", "root_joint": "none"}


def in_clips(**options: object) -> PoseData:
    return PoseData(HYPOTHESES, TRUTH, axes="NMTKD", **OPTIONS, **options)  # type: ignore[arg-type]


def flat(**options: object) -> PoseData:
    x, y = HYPOTHESES.reshape(2, 15, 4, 3), TRUTH.reshape(15, 4, 3)
    return PoseData(x, y, **OPTIONS, **options)  # type: ignore[arg-type]


def test_a_layout_with_clips_gives_their_labels() -> None:
    data = in_clips()
    assert data.labels["clip"].tolist() == data.labels["sequence"].tolist() == [*"000001111122222"]
    assert data.labels["horizon"].tolist() == [*"123451234512345"]
    assert data.clips is not None
    assert (data.clips.length, data.clips.numbered) == (5, ("clip", "sequence"))


def test_horizons_are_times_where_frames_per_second_are_known() -> None:
    assert in_clips(fps=25).labels["horizon"][:5].tolist() == ["40 ms", "80 ms", "120 ms", "160 ms", "200 ms"]
    assert in_clips(fps=60).labels["horizon"][:3].tolist() == ["17 ms", "33 ms", "50 ms"]
    assert in_clips(fps=4000).labels["horizon"][:3].tolist() == ["1", "2", "3"]  # not to be told apart in ms


def test_a_label_may_have_a_value_for_each_clip() -> None:
    labels = in_clips(labels={"sequence": ["a", "b", "b"], "action": ["walk", "sit", "sit"]}).labels
    assert labels["sequence"].tolist() == [*"aaaaabbbbbbbbbb"]
    assert labels["action"][[4, 5]].tolist() == ["walk", "sit"]
    assert labels["clip"].tolist() == [*"000001111122222"]


def test_labels_and_masks_may_be_of_each_frame_of_clips(tmp_path: Path) -> None:
    phase = np.array([[f"{c}{t}" for t in range(5)] for c in range(3)])
    mask = np.random.default_rng(0).random((3, 5, 4)) < 0.7
    given = {"labels": {"sequence": phase, "phase": phase}, "frame_id": phase, "occluded": ~mask, "where": mask}
    data = in_clips(**given)
    ravelled = {"labels": {"sequence": phase.ravel(), "phase": phase.ravel()}, "frame_id": phase.ravel()}
    one = in_clips(**ravelled, occluded=~mask.reshape(15, 4), where=mask.reshape(15, 4))
    assert data.where is not None
    assert data.occluded is not None
    assert data.where.tolist() == (~data.occluded).tolist() == mask.reshape(15, 4).tolist()
    for name in ("sequence", "phase", "clip"):
        assert data.labels[name].tolist() == one.labels[name].tolist()
    assert data.frame_id.tolist() == phase.ravel().tolist()
    members = {"sequence": phase, "valid": mask, "frame_id": phase}
    np.savez(tmp_path / "gt.npz", truth=TRUTH, axes="MTKD", **members)  # type: ignore[arg-type]
    stored = PoseData(HYPOTHESES, tmp_path / "gt.npz", axes="NMTKD", **OPTIONS)  # type: ignore[arg-type]
    assert stored.labels["sequence"].tolist() == phase.ravel().tolist()
    assert stored.where is not None
    assert stored.where.tolist() == mask.reshape(15, 4).tolist()


def test_a_label_of_other_clips_is_refused(tmp_path: Path) -> None:
    expected = (
        r"sequence \(5, 3\); expected one for each pose, \(M,\) = \(15,\), or each frame of clips, \(C, T\) = \(3, 5\)"
    )
    with pytest.raises(PoseDataError, match=expected):
        in_clips(labels={"sequence": np.full((5, 3), "a")})
    np.savez(tmp_path / "gt.npz", truth=TRUTH, axes="MTKD", sequence=np.full((5, 3), "a"))
    with pytest.raises(PoseDataError, match=expected):
        PoseData(HYPOTHESES, tmp_path / "gt.npz", axes="NMTKD", **OPTIONS)  # type: ignore[arg-type]


def test_a_label_of_another_length_is_refused() -> None:
    with pytest.raises(
        PoseDataError, match=r"sequence has 4 values for 15 poses; expected one each, or of the 3 clips"
    ):
        in_clips(labels={"sequence": [*"abcd"]})


def test_a_label_declares_clips_too() -> None:
    names = np.repeat(["b", "a", "c"], 5)
    data = flat(labels={"clip": names})
    assert data.labels["sequence"].tolist() == names.tolist()
    assert data.labels["horizon"].tolist() == [*"123451234512345"]
    assert data.clips is not None
    assert (data.clips.length, data.clips.numbered) == (5, ())
    assert flat().clips is None


def test_clips_of_one_name_in_several_sequences_are_several() -> None:
    data = flat(labels={"clip": np.repeat(["0", "1", "0"], 5), "sequence": np.repeat(["a", "a", "b"], 5)})
    assert data.labels["clip"][::5].tolist() == ["a / 0", "a / 1", "b / 0"]


def test_clips_of_fewer_frames_are_named_in_a_remark() -> None:
    data = flat(labels={"clip": np.repeat(["0", "1", "2"], [6, 6, 3])})
    assert data.clips is not None
    assert data.clips.length == 6
    assert [*data.remarks] == [
        "clip: 1 of 3 clips of fewer than T = 6 frames (first: 2): left out of ADE, FDE and all other metrics of whole "
        "clips."
    ]
    assert not in_clips().remarks


def test_horizons_of_one_s_own_stay() -> None:
    own = np.tile(["near", "near", "far", "far", "far"], 3)
    assert in_clips(labels={"horizon": own}).labels["horizon"].tolist() == own.tolist()


def test_frames_without_a_valid_joint_keep_the_horizons_of_the_others(tmp_path: object) -> None:
    valid = np.ones((15, 4), dtype=bool)
    valid[[5, 7]] = False  # frames 1 and 3 of clip 1
    np.savez(f"{tmp_path}/gt.npz", truth=TRUTH, axes="MTKD", valid=valid)
    np.savez(f"{tmp_path}/hyps.npz", hypotheses=HYPOTHESES, axes="NMTKD")
    data = PoseData(f"{tmp_path}/hyps.npz", f"{tmp_path}/gt.npz", **OPTIONS)  # type: ignore[arg-type]
    assert data.labels["horizon"].tolist() == [*"1234524512345"]
    assert any("1 of 3 clips of fewer than T = 5" in remark for remark in data.remarks)


def test_observed_poses_are_those_of_the_clips_by_name() -> None:
    observed = np.arange(36.0).reshape(3, 4, 3) / 1000
    data = PoseData(HYPOTHESES / 1000, TRUTH / 1000, axes="NMTKD", unit="m", root_joint="none", observed=observed)
    assert data.clips is not None
    assert [*data.clips.observed] == ["0", "1", "2"]
    np.testing.assert_allclose(data.clips.observed["1"], np.arange(12.0, 24.0).reshape(4, 3))
    named = flat(labels={"clip": np.repeat(["b", "a", "c"], 5)}, observed=observed * 1000)
    assert named.clips is not None
    np.testing.assert_allclose(named.clips.observed["a"], np.arange(12.0, 24.0).reshape(4, 3))


def test_undeclared_clips_are_refused_also_where_all_axes_are_as_long() -> None:
    cube = np.random.default_rng(0).normal(0, 100, (3, 3, 3, 3, 3))
    with pytest.raises(PoseDataError, match=r"Declare another layout of"):
        PoseData(cube, cube[0], unit="mm")
    assert PoseData(cube, cube[0], axes="NMTKD", unit="mm", truth_axes="MTKD").shape == (3, 9, 3, 3)
