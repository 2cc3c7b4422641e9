"""In which layout and unit two files are: what they declare, what their shapes tell, and what does not fit."""

import re
from typing import Any

import numpy as np
import pytest

from posecal.data.declarations import Declarations
from posecal.data.pose_data import match_poses
from posecal.data.skeleton import JOINT_SETS
from posecal.errors import PoseDataError
from tests.helpers.small_files import (
    FRAMES,
    K,
    M,
    N,
    coordinates,
    gt,
    hypotheses,
    hyps,
    ids,
    truth,
)

# --- axes -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("x", "y", "words"),
    [
        ((7, 17, 3), (5, 7, 17, 3), r"hyps\.npz \(7, 17, 3\) and gt\.npz \(5, 7, 17, 3\): expected \(N, M, K, D\) and "
         r"\(M, K, D\)\. The two look swapped\."),
        ((5, 7, 17, 3), (5, 7, 17, 3), r".*\. Declare another layout of gt\.npz with truth_axes\."),
        ((7, 7, 17, 3), (7, 17, 3), r".*, but the shapes don't tell the axes apart \(N = M = 7\)\. Pass "
         r"axes=.NMKD. or axes=.MNKD.\."),
        ((7, 5, 17, 3), (7, 17, 3), r".*\. The shapes fit axes=.MNKD.\."),
        ((7, 17, 5, 3), (7, 17, 3), r".*\. The shapes fit axes=.MKND.\."),
        ((5, 7, 3, 17), (7, 17, 3), r".*\. The shapes fit axes=.NMDK.\."),
        ((7, 5, 3, 17), (7, 17, 3), r".*\. The shapes fit axes=.MNDK.\."),
        ((7, 17, 3, 5), (7, 17, 3), r".*\. The shapes fit axes=.MKDN.\."),
        ((7, 3, 17, 5), (7, 17, 3), r".*\. The shapes fit axes=.MDKN.\."),
        ((5, 7, 17, 3), (7, 3, 17), r".*, coordinates last\. Pass truth_axes=.MDK.\."),
    ],
    ids=[
        *("swapped", "two hypotheses", "N = M", "hypotheses second", "hypotheses third"),
        *("coordinates first", "both", "hypotheses last", "hypotheses last, coordinates first", "truth's coordinates"),
    ],
)  # fmt: skip
def test_an_undeclared_order_of_axes_is_refused_with_the_flag_that_fits(
    x: tuple[int, ...], y: tuple[int, ...], words: str
) -> None:
    with pytest.raises(PoseDataError, match=f"^{words}$"):
        match_poses(hyps(np.ones(x)), gt(np.ones(y)))


def test_as_many_hypotheses_as_poses_are_read_where_the_axes_are_declared() -> None:
    seven = np.concatenate([hypotheses(), hypotheses()[:2] + 1])
    for axes, stored in (("NMKD", seven), ("MNKD", seven.transpose(1, 0, 2, 3))):
        np.testing.assert_array_equal(coordinates(match_poses(hyps(stored), gt(), Declarations(axes=axes))), seven)
        np.testing.assert_array_equal(coordinates(match_poses(hyps(stored, axes=axes), gt())), seven)


def test_swapped_arrays_are_known_by_any_declared_layout() -> None:
    with pytest.raises(PoseDataError, match=r"The two look swapped\.$"):
        match_poses(hyps(truth(), axes="NMKD"), gt(hypotheses(), axes="MKD"))


def test_a_flag_that_contradicts_the_file_is_refused() -> None:
    with pytest.raises(
        PoseDataError, match=r"^hyps\.npz declares 'NMKD' itself; expected no axes=.MNKD.\. Leave it out\.$"
    ):
        match_poses(hyps(axes="NMKD"), gt(), Declarations(axes="MNKD"))
    assert match_poses(hyps(axes="NMKD"), gt(), Declarations(axes="NMKD")).shape == (N, M, K, 3)


def test_a_layout_that_the_array_does_not_have_is_refused_by_file() -> None:
    with pytest.raises(PoseDataError, match=r"^gt\.npz: axes: \(KD\) has length 50; expected a multiple of 3"):
        match_poses(hyps(), gt(np.ones((7, 50)), axes="M(KD)"))
    with pytest.raises(PoseDataError, match=r"^hyps\.npz: axes: \(KD\) has length 50; expected a multiple of 3"):
        match_poses(hyps(np.ones((5, 7, 50)), axes="NM(KD)"), gt())
    with pytest.raises(PoseDataError, match=r"^hyps\.npz: axes: 'QRS' lacks N, M, K, D; expected"):
        match_poses(hyps(axes="QRS"), gt())


@pytest.mark.parametrize("axes", ["NMDK", "MNDK", "NMKD"])
def test_a_truth_with_coordinates_last_is_known_beside_any_hypotheses(axes: str) -> None:
    stored = hypotheses().transpose(["NMKD".index(letter) for letter in axes])
    fewer = gt(truth()[:4], frame_id=ids(*FRAMES[:4]))  # its M is another one
    pairs = match_poses(hyps(stored, axes=axes, frame_id=ids(*FRAMES)), fewer, Declarations(missing="skip"))
    np.testing.assert_array_equal(pairs.truth, truth()[:4])


def test_a_truth_stored_as_the_hypotheses_are_is_known() -> None:
    stored = hypotheses().transpose(1, 0, 3, 2)
    pairs = match_poses(hyps(stored, axes="MNDK"), gt(truth().transpose(0, 2, 1)))
    np.testing.assert_array_equal(pairs.truth, truth())


def test_three_joints_tell_no_layout_of_the_truth() -> None:
    stored = hypotheses()[:, :, :3].transpose(0, 1, 3, 2)
    with pytest.raises(
        PoseDataError,
        match=r"but the shapes don't tell the axes apart \(K = D = 3\)\. Pass truth_axes=.MKD. or truth_axes=.M.",
    ):
        match_poses(hyps(stored, axes="NMDK"), gt(truth()[:, :3]))
    np.testing.assert_array_equal(
        match_poses(hyps(stored, axes="NMDK"), gt(truth()[:, :3]), Declarations(truth_axes="MKD")).truth,
        truth()[:, :3],
    )


@pytest.mark.parametrize("x", [(0, 7, 17, 3), (5, 0, 17, 3), (5, 7, 0, 3)])
def test_an_axis_of_nothing_is_refused(x: tuple[int, ...]) -> None:
    with pytest.raises(PoseDataError, match=r"hyps\.npz: nothing in it; its shape is \("):
        match_poses(hyps(np.ones(x)), gt(np.ones(x[1:])))


def test_numbers_of_coordinates_that_differ_are_said() -> None:
    with pytest.raises(PoseDataError, match=r"^hyps\.npz has D = 2 and gt\.npz 3; expected as many\.$"):
        match_poses(hyps(hypotheses()[..., :2]), gt())


# --- units ----------------------------------------------------------------------------------------------------


def test_a_unit_that_is_none_is_named_with_its_file() -> None:
    with pytest.raises(PoseDataError, match=r"^gt\.npz: unit: 'inch'; expected mm, cm, m, or the millimetres in one"):
        match_poses(hyps(), gt(unit="inch"))


def test_a_unit_by_flag_must_not_contradict_the_file() -> None:
    with pytest.raises(
        PoseDataError, match=r"^gt\.npz declares 'mm' itself; expected no truth_unit=.m.\. Leave it out\.$"
    ):
        match_poses(hyps(), gt(unit="mm"), Declarations(truth_unit="m"))


def test_flags_that_can_not_be_are_refused_before_any_file_is_read() -> None:
    with pytest.raises(PoseDataError, match=r"^5 problems:") as refused:
        Declarations(axes="NMD", truth_axes="MD", unit="inch", truth_unit="yard", joints="h37m")
    for words in ("'NMD' lacks K", "'MD' lacks K", "'inch'", "'yard'", "'h37m' is not known"):
        assert words in str(refused.value)


# --- joints ---------------------------------------------------------------------------------------------------


def test_joints_are_names_or_a_joint_set() -> None:
    assert Declarations().joint_names is None
    assert Declarations(joints="h36m-17").joint_names == JOINT_SETS["h36m-17"]
    for names in (["a", "b"], ("a", "b"), np.array(["a", "b"])):
        assert Declarations(joints=names).joint_names == ("a", "b")  # type: ignore[arg-type]


@pytest.mark.parametrize("joints", [17, ["a", 2], [1, 2], [b"a"]])
def test_joints_that_are_no_names_are_refused(joints: Any) -> None:
    words = f"joints: {joints!r}; expected K names, or a joint set such as h36m-17."
    with pytest.raises(PoseDataError, match=f"^{re.escape(words)}$"):
        Declarations(joints=joints)


@pytest.mark.parametrize("root", ["Hip", "none", "3", 3, np.int64(3)])
def test_a_root_joint_is_a_name_or_an_index(root: Any) -> None:
    assert Declarations(root_joint=root).root_joint == root


@pytest.mark.parametrize("root", [True, 1.5, ["Hip"], np.array([3])])
def test_a_root_joint_that_is_neither_is_refused(root: Any) -> None:
    words = f"root_joint: {root!r}; expected a name, an index, or none."
    with pytest.raises(PoseDataError, match=f"^{re.escape(words)}$"):
        Declarations(root_joint=root)
