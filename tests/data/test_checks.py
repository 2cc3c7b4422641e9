"""Numbers that can't be people in millimetres are refused where no unit was declared, and remarked on where one was."""

import math
import statistics

import numpy as np
import pytest

from posecal.data.layout import MemoryArray
from posecal.data.match import Declarations, join
from posecal.data.pose_data import PoseData, StoredPoses
from posecal.data.skeleton import Skeleton
from posecal.errors import PoseDataError
from tests.helpers.small_files import JOINTS, hypotheses, truth


def joined(
    scale: float = 1,
    true_scale: float = 1,
    unit: str | None = None,
    true_unit: str | None = None,
    how: Declarations | None = None,
) -> PoseData:
    return join(
        StoredPoses("hyps.npz", MemoryArray(hypotheses() * np.float32(scale)), unit=unit, joints=JOINTS),
        StoredPoses("gt.npz", MemoryArray(truth() * np.float32(true_scale)), unit=true_unit, joints=JOINTS),
        how,
    )


def test_millimetres_are_taken_without_a_word() -> None:
    assert joined().remarks == ()


def test_metres_in_both_files_are_refused_with_the_flag() -> None:
    looks = r"looks like metres: joints lie 0\.\d+ from the middle of the pose; expected some 400 \(mm\)\."
    with pytest.raises(PoseDataError, match=rf"^gt\.npz {looks} hyps\.npz {looks} Pass --unit m, or store unit in "):
        joined(0.001, 0.001)


def test_metres_in_one_file_are_refused_by_its_name() -> None:
    with pytest.raises(
        PoseDataError, match=r"^hyps\.npz looks like metres: .*Pass --unit m, or store unit in the files"
    ):
        joined(0.001, 1)
    with pytest.raises(PoseDataError, match=r"^gt\.npz looks like metres: .*; --unit mm if it is right\.$"):
        joined(1, 0.001)


def test_metres_in_one_file_beside_declared_millimetres_are_refused() -> None:
    with pytest.raises(PoseDataError, match=r"^hyps\.npz looks like metres"):
        joined(0.001, 1, None, "mm")


def test_declared_metres_are_taken_without_a_word() -> None:
    assert joined(0.001, 0.001, "m", "m").remarks == ()
    assert joined(0.001, 0.001, how=Declarations(unit="m")).remarks == ()


def test_metres_declared_as_millimetres_are_remarked_on() -> None:
    first, second = joined(0.001, 0.001, "mm", "mm").remarks
    assert first.startswith("gt.npz looks like metres: joints lie 0.")
    assert second.startswith("hyps.npz looks like metres: joints lie 0.")
    assert second.endswith("Is its unit right?")


def test_two_units_are_refused_where_one_is_not_declared() -> None:
    words = r"^hyps\.npz and gt\.npz differ in size by a factor of 1\d\d; expected one unit\. Store unit in both, or "
    with pytest.raises(PoseDataError, match=words):
        joined(100, 1, None, "mm")


def test_two_declared_units_that_do_not_fit_are_remarked_on() -> None:
    (remark,) = joined(100, 1, "mm", "mm").remarks
    assert remark.startswith("hyps.npz and gt.npz differ in size by a factor of ")
    assert remark.endswith(". Are their units right?")


def test_a_spread_of_a_wild_model_is_no_other_unit() -> None:
    assert joined(3, 1).remarks == ()


@pytest.mark.parametrize("scale", [0.1, 4])
def test_bones_of_no_person_are_remarked_on(scale: float) -> None:
    bones = [pose[child] - pose[parent] for pose in truth() * scale for parent, child in Skeleton(JOINTS).bones]
    median = statistics.median(math.hypot(*bone) for bone in bones)
    assert joined(scale, scale).remarks == (
        f"the median bone of gt.npz is {median:,.1f} mm long; expected 50 to 700. Is its unit right?",
    )


def test_joints_without_names_have_no_bones_to_look_at() -> None:
    pairs = join(
        StoredPoses("hyps.npz", MemoryArray(hypotheses() / 10)),
        StoredPoses("gt.npz", MemoryArray(truth() / 10)),
        Declarations(),
    )
    assert pairs.remarks == ()


def test_poses_with_missing_coordinates_are_looked_at_by_the_others() -> None:
    some = truth() / 1000
    some[0, 3] = np.nan
    with pytest.raises(PoseDataError, match=r"^gt\.npz looks like metres"):
        join(StoredPoses("hyps.npz", MemoryArray(hypotheses())), StoredPoses("gt.npz", MemoryArray(some)))


def test_poses_that_are_all_unknown_or_all_at_one_point_say_nothing_of_their_unit() -> None:
    for array in (np.full_like(truth(), np.nan), np.zeros_like(truth())):
        pairs = join(
            StoredPoses("hyps.npz", MemoryArray(hypotheses())),
            StoredPoses("gt.npz", MemoryArray(array), joints=JOINTS),
        )
        assert all("metres" not in remark for remark in pairs.remarks)


def test_one_unit_for_both_is_no_word_for_files_that_differ_a_thousandfold() -> None:
    with pytest.raises(PoseDataError, match=r"differ in size by a factor of 971; .*--truth-unit for the other\.$"):
        joined(0.001, 1, how=Declarations(unit="m"))
    assert joined(0.001, 1, how=Declarations(unit="m", truth_unit="mm")).remarks == ()
