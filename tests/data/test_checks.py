"""Numbers that can't be people in millimetres are refused where no unit was declared, and remarked on where one was."""

import math
import re
import statistics

import numpy as np
import pytest

from posecal.data.checks import pose_size
from posecal.data.declarations import Declarations
from posecal.data.layout import MemoryArray
from posecal.data.pose_data import PoseData, match_poses
from posecal.data.skeleton import Skeleton
from posecal.data.stored_poses import StoredPoses
from posecal.errors import PoseDataError
from tests.helpers.small_files import JOINTS, hypotheses, truth


def joined(
    scale: float = 1,
    true_scale: float = 1,
    unit: str | None = None,
    true_unit: str | None = None,
    how: Declarations | None = None,
) -> PoseData:
    return match_poses(
        StoredPoses("hyps.npz", MemoryArray(hypotheses() * np.float32(scale)), unit=unit, joints=JOINTS),
        StoredPoses("gt.npz", MemoryArray(truth() * np.float32(true_scale)), unit=true_unit, joints=JOINTS),
        how,
    )


def test_millimetres_are_taken_without_a_word() -> None:
    assert joined().remarks == ()


def test_two_coordinates_without_a_unit_are_remarked_on() -> None:
    words = "two coordinates without a unit are taken as mm"
    for unit, expected in ((None, [words]), ("mm", []), ("px", [])):
        data = PoseData(hypotheses()[..., :2], truth()[..., :2], joints=JOINTS, unit=unit, axes="NMKD")
        assert [remark.split(";")[0] for remark in data.remarks if words in remark] == expected


def test_single_coordinates_without_a_unit_are_remarked_on() -> None:
    x, y = hypotheses()[..., 2:], truth()[..., 2:]
    for unit, number in ((None, 1), ("mm", 0), ("deg", 0)):
        data = PoseData(x, y, joints=JOINTS, unit=unit, axes="NMKD", truth_axes="MKD")
        assert sum("single coordinates without a unit are taken as mm" in remark for remark in data.remarks) == number


def angles(scale: float = 1, true_scale: float = 1, unit: str = "deg", spread: float = 8) -> list[str]:
    """The remarks on angles of three joints."""
    random = np.random.default_rng(0)
    y = random.uniform(-150, 150, (60, 3, 1))
    x = y + random.normal(0, spread, (12, *y.shape))
    return [*PoseData(x * scale, y * true_scale, unit=unit, axes="NMKD", truth_axes="MKD").remarks]


def test_angles_that_look_like_radians_are_remarked_on() -> None:
    degree = math.radians(1)
    (remark,) = angles(degree, degree)
    assert remark.startswith("all angles lie within 6.3 degrees. Are they radians?")
    for scale, true_scale in ((degree, 1), (1, degree)):
        (remark,) = angles(scale, true_scale)
        assert re.fullmatch(
            r"hypotheses and truth differ in size by a factor of (5\d|60)\. Is one of the two in radians\?", remark
        )
    assert angles() == angles(degree, degree, "rad") == angles(spread=90) == angles(0.05, 0.05, "rad") == []


@pytest.mark.parametrize("number", [0, 1, 10])
def test_true_poses_of_two_units_are_remarked_on(number: int) -> None:
    y = np.random.default_rng(0).normal(0, 300, (40, 17, 3))
    y[40 - number :] /= 1000
    data = PoseData(np.stack([y, y + 1]), y, joints=JOINTS, unit="mm", axes="NMKD")
    poses = f"{number} of 40 poses"
    words = f"the size of {poses} of truth differs from that of most over 50 times. Are all in one unit?"
    assert [remark for remark in data.remarks if "the size of" in remark] == [words] * (number > 0)


def test_every_true_pose_is_looked_at_for_another_unit() -> None:
    y = np.random.default_rng(0).normal(0, 300, (9000, 5, 3))
    y[[1, 4099, 8999]] /= 1000
    (remark,) = (each for each in PoseData(y[None], y, unit="mm", axes="NMKD").remarks if "the size of" in each)
    assert remark.startswith("the size of 3 of 9,000 poses of truth differs")


@pytest.mark.parametrize("where", [False, True])
def test_one_joint_far_away_or_masked_makes_no_other_unit(where: bool) -> None:
    y = np.random.default_rng(0).normal(0, 300, (40, 17, 3))
    y[3, 5] = 1e6
    mask = None
    if where:
        y[4], mask = y[4] * 1e4, np.ones((40, 17), dtype=bool)
        mask[4, :16] = False
    data = PoseData(np.stack([y, y + 1]), y, joints=JOINTS, unit="mm", axes="NMKD", where=mask)
    assert not [remark for remark in data.remarks if "one unit" in remark]


def test_millimetres_declared_as_metres_are_remarked_on() -> None:
    assert PoseData(hypotheses(), truth(), unit="m", axes="NMKD").remarks[-1].startswith("joints of truth lie 513 m")


LOOKS = "looks like metres: joints lie 0.53 from the middle of the pose; expected some 400 (mm)."
TRUTH_LOOKS = LOOKS.replace("0.53", "0.51")


@pytest.mark.parametrize(
    ("scale", "true_scale", "true_unit", "words", "advised"),
    [
        (0.001, 0.001, None, [f"gt.npz {TRUTH_LOOKS}", f"hyps.npz {LOOKS}", 'Pass unit="m", or', 'unit="mm" if'], "m"),
        (0.001, 1, None, [f"hyps.npz {LOOKS}", 'Pass unit="m" and truth_unit="mm", or', 'unit="mm" if'], "m mm"),
        (0.001, 1, "mm", [f"hyps.npz {LOOKS}", 'Pass unit="m", or', 'unit="mm" if'], "m"),
        (1, 0.001, None, [f"gt.npz {TRUTH_LOOKS}", 'Pass truth_unit="m", or', 'truth_unit="mm" if'], "- m"),
    ],
    ids=["both", "hypotheses", "hypotheses beside a declared truth", "truth"],
)
def test_metres_are_refused_by_name_with_advice_that_helps(
    scale: float, true_scale: float, true_unit: str | None, words: list[str], advised: str
) -> None:
    *looks, first, second = words
    expected = f"{' '.join(looks)} {first} store unit in the files; {second} it is right."
    with pytest.raises(PoseDataError, match=f"^{re.escape(expected)}$"):
        joined(scale, true_scale, true_unit=true_unit)
    unit, own = [*(None if word == "-" else word for word in advised.split()), None][:2]
    assert joined(scale, true_scale, true_unit=true_unit, how=Declarations(unit=unit, truth_unit=own)).remarks == ()


def standing(size: float, joints: tuple[str, ...] | None = None) -> StoredPoses:
    """Poses of two joints that lie so far, in mm, from their middle."""
    poses = np.array([[[size, 0, 0], [-size, 0, 0]]] * 3)
    return StoredPoses("gt.npz", MemoryArray(poses), joints=joints)


def hypotheses_of(size: float) -> StoredPoses:
    """Two hypotheses of as many poses, alike."""
    poses = standing(size).array.part((slice(0, 3), slice(0, 2), slice(0, 3)))
    return StoredPoses("hyps.npz", MemoryArray(np.stack([poses, poses])))


@pytest.mark.parametrize("size", [0.4, 1.0, 1.5, 5.0, 9.99])
def test_poses_below_a_centimetre_are_taken_for_metres(size: float) -> None:
    assert pose_size(np.array([[[size, 0, 0], [-size, 0, 0]]])) == pytest.approx(size)
    with pytest.raises(PoseDataError, match=rf"^gt\.npz looks like metres: joints lie {size:.2g} from the middle"):
        match_poses(hypotheses_of(100), standing(size))
    with pytest.raises(PoseDataError, match=rf"^hyps\.npz looks like metres: joints lie {size:.2g} from the middle"):
        match_poses(hypotheses_of(size), standing(100))


@pytest.mark.parametrize("size", [0.0, 10.0, 11.0])
def test_larger_poses_and_those_at_one_point_are_not_taken_for_metres(size: float) -> None:
    for predicted, true in ((size, 100), (100, size), (size, size)):
        assert not any("metres" in r for r in match_poses(hypotheses_of(predicted), standing(true)).remarks)


@pytest.mark.parametrize(("scale", "refused"), [(20.5, True), (20, True), (19.5, False)])
def test_sizes_may_differ_twentyfold_before_they_are_taken_for_two_units(scale: float, refused: bool) -> None:
    for predicted, true in ((10 * scale, 10), (10, 10 * scale)):
        if refused:
            with pytest.raises(
                PoseDataError, match=r"^hyps\.npz and gt\.npz differ in size by a factor of 20; expected"
            ):
                match_poses(hypotheses_of(predicted), standing(true))
        else:
            match_poses(hypotheses_of(predicted), standing(true))


@pytest.mark.parametrize(("size", "true_size"), [(0.4, 100), (100, 0.4)])
def test_small_poses_of_declared_units_may_still_differ_in_size(size: float, true_size: float) -> None:
    declared = Declarations(unit="mm", truth_unit="mm")
    tiny, differing = match_poses(hypotheses_of(size), standing(true_size), declared).remarks[-2:]
    assert "looks like metres" in tiny
    assert differing == "hyps.npz and gt.npz differ in size by a factor of 250. Are their units right?"


def test_the_size_of_many_poses_is_that_of_some_evenly_chosen() -> None:
    small, large = (np.array([[size, 0, 0], [-size, 0, 0]]) for size in (100.0, 300.0))
    assert pose_size(np.array([small, large] * 499 + [small])) == 100
    assert pose_size(np.array([small, large] * 500)) == 100
    assert pose_size(np.array([small, large, large] * 166)) == 300


def test_the_median_bone_is_judged() -> None:
    poses = np.zeros((3, 4, 3))
    poses[:, :, 2] = [0, 10, 40, 340]  # bones of 10, 30 and 300 mm
    true = StoredPoses("gt.npz", MemoryArray(poses), joints=("Hip", "RHip", "RKnee", "RFoot"))
    data = match_poses(StoredPoses("hyps.npz", MemoryArray(np.stack([poses, poses]))), true)
    assert data.remarks == ("the median bone of gt.npz is 30.0 mm long; expected 50 to 700. Is its unit right?",)


@pytest.mark.parametrize(("length", "remarked"), [(49.9, True), (50, False), (700, False), (700.1, True)])
def test_bones_from_5_to_70_centimetres_are_taken_without_a_word(length: float, remarked: bool) -> None:
    data = match_poses(hypotheses_of(length / 2), standing(length / 2, ("RHip", "RKnee")))
    assert [remark for remark in data.remarks if "bone" in remark] == [
        f"the median bone of gt.npz is {length:.1f} mm long; expected 50 to 700. Is its unit right?"
    ] * remarked


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
    assert second.endswith("Is the unit of hyps.npz right?")


def test_two_units_are_refused_where_one_is_not_declared() -> None:
    words = r"^hyps\.npz and gt\.npz differ in size by a factor of 1\d\d; expected one unit\. Store unit in both, or "
    with pytest.raises(PoseDataError, match=words):
        joined(100, 1, None, "mm")


@pytest.mark.parametrize(
    ("unit", "true_unit", "how", "remarked"),
    [
        ("mm", None, Declarations(), False),
        (None, "mm", Declarations(), False),
        (None, None, Declarations(unit="mm"), False),
        ("mm", None, Declarations(unit="mm"), False),
        (None, "mm", Declarations(unit="mm"), True),
        (None, None, Declarations(truth_unit="mm"), True),
        (None, None, Declarations(unit="mm", truth_unit="mm"), True),
        ("mm", "mm", Declarations(), True),
    ],
)
def test_sizes_that_differ_are_remarked_on_where_each_unit_is_declared_and_else_refused(
    unit: str | None, true_unit: str | None, how: Declarations, remarked: bool
) -> None:
    if remarked:
        assert "differ in size by a factor of 1" in joined(100, 1, unit, true_unit, how).remarks[0]
    else:
        with pytest.raises(PoseDataError, match=r"differ in size by a factor of 1\d\d; expected one unit"):
            joined(100, 1, unit, true_unit, how)


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
    pairs = match_poses(
        StoredPoses("hyps.npz", MemoryArray(hypotheses() / 10)),
        StoredPoses("gt.npz", MemoryArray(truth() / 10)),
        Declarations(),
    )
    (remark,) = pairs.remarks  # as small as a hand
    assert remark.startswith(
        "gt.npz may be in centimetres: joints lie 53 from the middle of the pose, as those of a hand"
    )
    declared = match_poses(
        StoredPoses("hyps.npz", MemoryArray(hypotheses() / 10)),
        StoredPoses("gt.npz", MemoryArray(truth() / 10)),
        Declarations(unit="mm"),
    )
    assert declared.remarks == ()


def test_poses_with_missing_coordinates_are_looked_at_by_the_others() -> None:
    some = truth() / 1000
    some[0, 3] = np.nan
    with pytest.raises(PoseDataError, match=r"^gt\.npz looks like metres"):
        match_poses(StoredPoses("hyps.npz", MemoryArray(hypotheses())), StoredPoses("gt.npz", MemoryArray(some)))


def test_poses_that_are_all_unknown_or_all_at_one_point_say_nothing_of_their_unit() -> None:
    for array in (np.full_like(truth(), np.nan), np.zeros_like(truth())):
        pairs = match_poses(
            StoredPoses("hyps.npz", MemoryArray(hypotheses())),
            StoredPoses("gt.npz", MemoryArray(array), joints=JOINTS),
        )
        assert all("metres" not in remark for remark in pairs.remarks)


def test_one_unit_for_both_is_no_word_for_files_that_differ_a_thousandfold() -> None:
    with pytest.raises(PoseDataError, match=r"differ in size by a factor of 971; .*truth_unit for the other\.$"):
        joined(0.001, 1, how=Declarations(unit="m"))
    assert joined(0.001, 1, how=Declarations(unit="m", truth_unit="mm")).remarks == ()
