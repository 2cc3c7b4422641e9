"""Pose data of arrays, of files and of one of each: the same whatever they are made of, and refused all at once."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from posecal.data.pose_data import PoseData
from posecal.errors import PoseDataError, PoseFileError, for_command_line
from tests.helpers.small_files import (
    FRAMES,
    JOINTS,
    OCCLUDED,
    SCORES,
    WORDS,
    K,
    M,
    N,
    coordinates,
    hypotheses,
    hypotheses_file,
    same,
    truth,
    truth_file,
)


def refused(words: str, *sides: Any, **arguments: Any) -> None:
    """Check that everything is refused with these words, in full."""
    with pytest.raises(PoseDataError, match=f"^{re.escape(words)}$"):
        PoseData(*(sides or (hypotheses(), truth())), **arguments)


# --- what it is made of ---------------------------------------------------------------------------------------


def test_arrays_give_what_files_give(tmp_path: Path) -> None:
    of_files = PoseData(
        hypotheses_file(tmp_path, scores=SCORES),
        truth_file(tmp_path, occluded=OCCLUDED, action=WORDS, fps=25.0, frame_id=np.array(FRAMES)),
    )
    of_arrays = PoseData(
        hypotheses(),
        truth(),
        joints="h36m-17",
        labels={"action": WORDS},
        occluded=OCCLUDED,
        scores=SCORES,
        fps=25,
        frame_id=FRAMES,
    )
    same(of_arrays, of_files)
    assert of_arrays.names == ("hypotheses", "truth")
    assert of_files.names == ("hyps.npz", "gt.npz")
    assert of_arrays.shape == (N, M, K, 3)
    assert repr(of_arrays) == "PoseData('hypotheses', 'truth': N=5, M=7, K=17, D=3)"


@pytest.mark.parametrize("kind", [str, Path])
def test_one_side_may_be_a_file_and_the_other_an_array(tmp_path: Path, kind: Any) -> None:
    expected = PoseData(hypotheses(), truth(), joints=JOINTS)
    same(PoseData(kind(hypotheses_file(tmp_path)), truth(), joints=JOINTS), expected)
    same(PoseData(hypotheses(), kind(truth_file(tmp_path))), expected)


def test_lists_are_arrays() -> None:
    of_lists = PoseData(hypotheses().tolist(), truth().tolist())
    same(of_lists, PoseData(hypotheses().astype("f8"), truth().astype("f8")))


# --- what is declared -----------------------------------------------------------------------------------------


def test_layouts_and_units_are_declared() -> None:
    expected = PoseData(hypotheses(), truth())
    turned = hypotheses().transpose(1, 0, 3, 2), truth().transpose(0, 2, 1)
    same(PoseData(*turned, axes="MNDK", truth_axes="MDK"), expected)
    for unit in ("m", 1000, 1000.0, "1000"):
        data = PoseData(hypotheses() / 1000, truth() / 1000, unit=unit)
        np.testing.assert_allclose(coordinates(data), hypotheses(), atol=1e-3)
        np.testing.assert_allclose(data.truth, truth(), atol=1e-3)
    mixed = PoseData(hypotheses() / 1000, truth() / 10, unit="m", truth_unit="cm")
    np.testing.assert_allclose(mixed.truth, truth(), atol=1e-3)


def test_a_unit_is_for_what_declares_none(tmp_path: Path) -> None:
    data = PoseData(hypotheses() / 1000, truth_file(tmp_path, unit="mm"), unit="m")
    np.testing.assert_allclose(coordinates(data), hypotheses(), atol=1e-3)
    np.testing.assert_array_equal(data.truth, truth())
    refused(
        "2 problems:\n  - hyps.npz declares 'mm' itself; expected no unit=\"m\". Leave it out.\n"
        "  - gt.npz declares 'mm' itself; expected no unit=\"m\". Leave it out.",
        hypotheses_file(tmp_path, unit="mm"),
        truth_file(tmp_path, unit="mm"),
        unit="m",
    )


def test_as_many_hypotheses_as_poses_are_never_guessed() -> None:
    seven = np.concatenate([hypotheses(), hypotheses()[:2]])
    refused(
        "hypotheses (7, 7, 17, 3) and truth (7, 17, 3): expected (N, M, K, D) and (M, K, D), but the shapes don't tell "
        'the axes apart (N = M = 7). Pass axes="NMKD" or axes="MNKD".',
        seven,
        truth(),
    )
    np.testing.assert_array_equal(coordinates(PoseData(seven, truth(), axes="NMKD")), seven)
    np.testing.assert_array_equal(coordinates(PoseData(seven, truth(), axes="MNKD")), seven.swapaxes(0, 1))


@pytest.mark.parametrize(
    ("x", "y", "equal", "fitting"),
    [
        ((5, 7, 3, 3), (7, 3, 3), "K = D = 3", ("NMKD", "NMDK")),
        ((7, 17, 17, 3), (7, 17, 3), "N = K = 17", ("MNKD", "MKND")),
    ],
)
def test_other_axes_of_one_length_are_not_guessed_either(
    x: tuple[int, ...], y: tuple[int, ...], equal: str, fitting: tuple[str, ...]
) -> None:
    options = " or ".join(f'axes="{text}"' for text in fitting)
    with pytest.raises(PoseDataError, match=rf"don't tell the axes apart \({equal}\)\. Pass {options}\.$"):
        PoseData(np.ones(x), np.ones(y))


def test_arrays_in_metres_are_refused_unless_that_is_declared() -> None:
    with pytest.raises(PoseDataError, match=r'^truth looks like metres: .* Pass unit="m", or store'):
        PoseData(hypotheses() / 1000, truth() / 1000)
    with pytest.raises(PoseDataError) as error:
        PoseData(hypotheses() / 1000, truth() / 1000)
    assert "Pass --unit m, or store" in for_command_line(error.value.message)


@pytest.mark.parametrize("names", [list(JOINTS), np.array(JOINTS), JOINTS])
def test_joints_are_named_by_sequences_of_names(names: Any) -> None:
    assert PoseData(hypotheses(), truth(), joints=names).joints == JOINTS


@pytest.mark.parametrize(("root_joint", "root"), [("Head", 10), (3, 3), (np.int64(3), 3), ("3", 3), ("none", None)])
def test_a_root_is_a_name_an_index_or_none(root_joint: Any, root: int | None) -> None:
    assert PoseData(hypotheses(), truth(), joints=JOINTS, root_joint=root_joint).root == root


def test_a_label_is_an_array_or_one_value_for_all_poses() -> None:
    frame = pd.DataFrame({"action": WORDS})
    labels: dict[str, Any] = {
        "sequence": "S9",
        "camera": 3,
        "hard": np.bool_(True),
        "action": frame["action"],
        "take": np.arange(M),
    }
    data = PoseData(hypotheses(), truth(), labels=labels)
    assert {name: values.tolist() for name, values in data.labels.items()} == {
        "sequence": ["S9"] * M,
        "camera": ["3"] * M,
        "hard": ["yes"] * M,
        "action": WORDS.tolist(),
        "take": [*"0123456"],
    }


def test_what_is_passed_takes_the_place_of_what_a_file_holds(tmp_path: Path) -> None:
    files = (
        hypotheses_file(tmp_path, scores=SCORES * 0),
        truth_file(tmp_path, visible=OCCLUDED, action=WORDS[::-1], camera=WORDS, fps=50),
    )
    data = PoseData(*files, scores=SCORES, occluded=OCCLUDED, labels={"action": WORDS}, fps=25)
    np.testing.assert_array_equal(data.scores, SCORES)
    np.testing.assert_array_equal(data.occluded, OCCLUDED)
    assert data.labels["action"].tolist() == data.labels["camera"].tolist() == WORDS.tolist()
    assert data.fps == 25


def test_the_mask_is_of_the_truth_as_it_is_passed(tmp_path: Path) -> None:
    where = np.arange(M * K).reshape(M, K) % 3 != 0
    part = hypotheses_file(tmp_path, hypotheses=hypotheses()[:, [4, 2]][:, :, 5:], joints=JOINTS[5:])
    ids: dict[str, Any] = {"frame_id": ["e", "c"], "truth_frame_id": [*"abcdefg"]}
    data = PoseData(
        part, truth(), where=where, occluded=OCCLUDED, joints=JOINTS, **ids, missing="skip", shared_joints="common"
    )
    np.testing.assert_array_equal(data.where, where[[2, 4], 5:])
    np.testing.assert_array_equal(data.occluded, OCCLUDED[[2, 4], 5:])


# --- frames ---------------------------------------------------------------------------------------------------


def test_one_frame_id_names_the_frames_of_both() -> None:
    data = PoseData(hypotheses(), truth(), frame_id=FRAMES)
    assert data.frame_id.tolist() == FRAMES
    same(data, PoseData(hypotheses(), truth()), but=("names", "remarks", "frame_id", "has_frame_id"))


def test_two_frame_ids_match_the_frames() -> None:
    order = [6, 2, 0, 5, 1, 4, 3]
    ids = np.array(FRAMES)
    data = PoseData(hypotheses()[:, order], truth(), frame_id=ids[order], truth_frame_id=ids)
    same(data, PoseData(hypotheses(), truth(), frame_id=ids))


def test_the_frame_ids_of_a_file_are_kept_beside_those_of_an_array(tmp_path: Path) -> None:
    data = PoseData(hypotheses()[:, ::-1], truth_file(tmp_path, frame_id=FRAMES), frame_id=FRAMES[::-1])
    np.testing.assert_array_equal(coordinates(data), hypotheses())
    assert data.frame_id.tolist() == FRAMES


def test_frames_that_one_side_lacks_may_be_skipped() -> None:
    sides = hypotheses()[:, :4], truth()
    ids: dict[str, Any] = {"frame_id": FRAMES[:4], "truth_frame_id": FRAMES}
    refused(
        "hypotheses lacks 3 of the 7 frames of truth (first: S9/walk/000, S9/walk/012, S9/walk/007). "
        'Pass missing="skip" to score the rest.',
        *sides,
        **ids,
    )
    data = PoseData(*sides, **ids, missing="skip", labels={"action": WORDS})
    assert data.frame_id.tolist() == FRAMES[:4]
    assert data.labels["action"].tolist() == WORDS[:4].tolist()
    assert data.order.tolist() == [0, 1, 2, 3]


def test_the_first_hypotheses_may_be_kept() -> None:
    data = PoseData(hypotheses(), truth(), n_hypotheses=2, scores=SCORES)
    np.testing.assert_array_equal(coordinates(data), hypotheses()[:2])
    np.testing.assert_array_equal(data.scores, SCORES[:2])


# --- what is refused ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (
            {"where": np.full((M, K), 0.5)},
            "where: float64 (7, 17); expected bool (M, K) = (7, 17) or (M,), T",
        ),
        (
            {"where": OCCLUDED.T},
            "where: bool (17, 7); expected bool (M, K) = (7, 17) or (M,), True where a joint counts.",
        ),
        ({"where": [[True], []]}, "where: lists of unequal lengths; expected an array."),
        ({"occluded": OCCLUDED * 2}, "occluded: dtype int64, values 0, 2; expected bool (M, K), or numbers 0 and 1."),
        ({"occluded": OCCLUDED.T}, "truth: occluded (17, 7); expected (M, K) = (7, 17)."),
        ({"scores": SCORES.T}, "hypotheses: scores (7, 5); expected (N, M) = (5, 7)."),
        ({"scores": SCORES * np.nan}, "scores: 35 of 35 are NaN; expected numbers (N, M)."),
        ({"scores": "high"}, "scores: str; expected real numbers such as float32."),
        ({"fps": 0}, "fps: 0; expected frames per second, above 0."),
        ({"fps": "fast"}, "fps: 'fast'; expected frames per second, above 0."),
        ({"fps": True}, "fps: True; expected frames per second, above 0."),
        ({"fps": [25, 50]}, "fps: [25, 50]; expected frames per second, above 0."),
        ({"labels": {"action": WORDS[:3]}}, "truth: action has 3 values for 7 poses; expected one each."),
        ({"labels": {"take": ["a"]}}, "truth: take has 1 values for 7 poses; expected one each."),
        ({"labels": {"speed": np.ones(M)}}, "speed: float64 (7,); expected one word or whole number per pose, (M,)."),
        ({"labels": {"speed": 0.5}}, "speed: float64 (); expected one word or whole number per pose, (M,)."),
        ({"labels": {"who": [None] * M}}, "who: object (7,); expected one word or whole number per pose, (M,)."),
        ({"labels": ["action"]}, "labels: list; expected a mapping of names, such as sequence, to values."),
        ({"frame_id": FRAMES[:3]}, "2 problems:\n  - hypotheses: 3 frame_id for 7 poses; expected one each."),
        ({"frame_id": "S9"}, "frame_id: <U2 (); expected one word or whole number per pose, (M,)."),
        ({"unit": "inch"}, "unit: 'inch'; expected mm, cm, m, or the millimetres in one unit as a number (25.4) or"),
        ({"unit": -3}, "unit: -3; expected mm, cm, m, or the millimetres in one unit as a number (25.4) or"),
        ({"unit": ["mm"]}, "unit: ['mm']; expected mm, cm, m, or the millimetres in one unit as a number (25.4) or"),
        ({"axes": "NMD"}, "axes: 'NMD' lacks K; expected each letter of NMKD once, such as MNKD or MN(DK)."),
        ({"axes": 4}, "axes: 4 lacks N, M, K, D; expected each letter of NMKD once, such as MNKD or MN(DK)."),
        ({"axes": [*"NMKD"]}, "axes: ['N', 'M', 'K', 'D'] is no layout; expected each letter of NMKD once, such as MN"),
        ({"truth_axes": "KD"}, "axes: 'KD' lacks M; expected each letter of MKD once, such as MDK or M(DK)."),
        ({"missing": "drop"}, "missing: 'drop' is not known. Known: error, skip, part."),
        ({"missing": True}, "missing: True is not known. Known: error, skip, part."),
        ({"shared_joints": "all"}, "shared_joints: 'all' is not known. Known: same, common."),
        ({"joints": "h36m-71"}, "joint set: 'h36m-71' is not known. Did you mean h36m-17?"),
        ({"joints": JOINTS[:3]}, "2 problems:\n  - hypotheses: 3 joints named for K = 17; expected one name each."),
        ({"joints": 17}, "joints: 17; expected K names, or a joint set such as h36m-17."),
        ({"joints": range(17)}, "joints: range(0, 17); expected K names, or a joint set such as h36m-17."),
        ({"root_joint": 17}, "root_joint: 17 is not among the joints."),
        ({"root_joint": True}, "root_joint: True; expected a name, an index, or none."),
        ({"root_joint": 1.5}, "root_joint: 1.5; expected a name, an index, or none."),
        ({"n_hypotheses": 6}, "n_hypotheses: 6; expected 1 to N = 5, the hypotheses of hypotheses."),
    ],
    ids=lambda value: "+".join(value) if isinstance(value, dict) else "",
)
def test_an_argument_that_can_not_be_is_refused(arguments: dict[str, Any], words: str) -> None:
    with pytest.raises(PoseDataError, match=f"^{re.escape(words)}"):
        PoseData(hypotheses(), truth(), **arguments)


@pytest.mark.parametrize(
    ("side", "words"),
    [
        (None, "NoneType; expected real numbers such as float32."),
        (5, "nothing"),
        (object(), "object; expected real numbers such as float32."),
        ({"a": 1}, "dict; expected real numbers such as float32."),
        ([["a"]], "dtype <U1; expected real numbers such as float32."),
        ([[1, 2], [3]], "lists of unequal lengths; expected an array."),
        (np.zeros((M, K, 3), complex), "dtype complex128; expected real numbers such as float32."),
        (np.ma.masked_less(truth(), 0), "masked numbers; expected an array without."),
    ],
    ids=lambda value: type(value).__name__ if not isinstance(value, str) else "",
)
def test_what_is_no_array_of_numbers_is_refused(side: Any, words: str) -> None:
    if words == "nothing":
        with pytest.raises(
            PoseDataError, match=r"^hypotheses \(5, 7, 17, 3\) and truth \(\): expected \(N, M, K, D\) a"
        ):
            PoseData(hypotheses(), side)
        return
    with pytest.raises(PoseDataError, match=f"^truth: {re.escape(words)}"):
        PoseData(hypotheses(), side)


def test_everything_that_is_wrong_is_said_at_once() -> None:
    with pytest.raises(PoseFileError, match=r"^7 problems:") as error:
        PoseData(
            None,  # type: ignore[arg-type]
            "here.npz",
            labels={"a": 0.5, "b": 1.5},
            occluded=[2],
            where=[[True], []],
            unit="inch",
        )
    words = str(error.value)
    for part in (
        "unit: 'inch'",
        "hypotheses: NoneType",
        "here.npz: no such file",
        "a: float64",
        "occluded: dtype",
        "where",
    ):
        assert part in words


def test_what_does_not_fit_is_said_at_once() -> None:
    with pytest.raises(PoseDataError, match=r"^6 problems:") as error:
        PoseData(
            hypotheses()[:, :6],
            truth(),
            labels={"action": WORDS[:2]},
            occluded=OCCLUDED.T,
            scores=SCORES,
            where=OCCLUDED.T,
            fps=-1,
            n_hypotheses=2,
        )
    for words in ("M = 6 poses", "action has 2 values", "occluded (17, 7)", "scores (5, 7)", "where: bool", "fps: -1"):
        assert words in str(error.value)


def test_two_missing_files_are_both_named() -> None:
    with pytest.raises(PoseFileError, match=r"^2 problems:\n  - h\.npz: no such file\.\n  - g\.npz: no such file\.$"):
        PoseData("h.npz", "g.npz")
