"""Signed areas on a skeleton, and poses in 3D: upright, with each joint where it belongs."""

from collections.abc import Iterator
from typing import cast

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d.art3d import Line3DCollection
from mpl_toolkits.mplot3d.axes3d import Axes3D

import posecal
from posecal.data.pose_data import PoseData
from posecal.data.skeleton import JOINT_SETS, Skeleton
from posecal.demo import sample
from posecal.errors import PoseDataError
from posecal.plot import draw_poses, frames_of, poses, signed_areas
from posecal.plot.layout import free_sides, joint_places
from posecal.plot.style import OVER, UNDER
from tests.helpers.reports import report_of, unlabelled, world

JOINTS = posecal.JOINT_SETS["h36m-17"]


@pytest.fixture
def ax() -> Axes:
    return Figure().add_subplot()


@pytest.fixture
def space() -> Axes3D:
    return cast(Axes3D, Figure().add_subplot(projection="3d"))


@pytest.fixture(autouse=True)
def _no_figure_is_left() -> Iterator[None]:
    from matplotlib import pyplot as plt

    yield
    plt.close("all")


def pairs() -> PoseData:
    """Twelve frames of one sequence of each action, named."""
    here = world()
    ids = np.array([f"{name}/{number}" for number, name in enumerate(here.sequence)])
    return PoseData(sample(here, 8), here.truth, axes="NMKD", unit="mm", joints=JOINTS, frame_id=ids)


# --- signed areas ---------------------------------------------------------------------------------------------


def discs(ax: Axes) -> dict[str, tuple[float, str, np.ndarray]]:
    """By joint: the area of its disc, its colour and its place."""
    return {
        str(c.get_gid()): (float(c.get_sizes()[0]), to_hex(c.get_facecolor()[0]), np.asarray(c.get_offsets())[0])
        for c in ax.collections
        if c.get_gid() is not None
    }


def test_every_joint_has_a_disc_that_grows_with_its_area_in_the_colour_of_its_side(ax: Axes) -> None:
    report = report_of()
    signed_areas(report, ax=ax)
    found = discs(ax)
    assert set(found) == set(JOINTS[1:])
    values = {name: report.value("signed_area", joint=name) for name in found}
    assert {np.sign(value) for value in values.values()} == {-1, 1}
    for name, (_, colour, _) in found.items():
        assert colour == (OVER if values[name] < 0 else UNDER).lower()
    by_size = sorted(found, key=lambda name: found[name][0])
    assert by_size == sorted(found, key=lambda name: abs(values[name]))


def test_the_numbers_stand_beside_their_joints_with_their_signs(ax: Axes) -> None:
    report = report_of()
    signed_areas(report, ax=ax)
    shown = {text.get_text() for text in ax.texts}
    for name in JOINTS[1:]:
        assert f"{report.value('signed_area', joint=name):+.3f}".replace("-", "−") in shown


def test_the_person_stands_with_the_head_up_and_faces_the_reader(ax: Axes) -> None:
    signed_areas(report_of(), ax=ax)
    at = {name: place for name, (_, _, place) in discs(ax).items()}
    assert at["Head"][1] > at["Thorax"][1] > at["LKnee"][1] > at["LFoot"][1]
    assert at["RWrist"][0] < 0 < at["LWrist"][0]
    sides = {text.get_text(): text.get_position()[0] for text in ax.texts if "side" in text.get_text()}
    assert sides["right side"] < sides["left side"]


def test_joints_without_a_place_on_a_person_are_points_with_their_names(ax: Axes) -> None:
    report = unlabelled()
    signed_areas(report, ax=ax)
    texts = [text.get_text().split("\n")[0] for text in ax.texts]
    assert texts == [name for name in report.totals.spec.joints if not np.isnan(report.value("ece", joint=name))]
    assert not any("side" in text for text in texts)


@pytest.mark.parametrize("name", JOINT_SETS)
def test_every_joint_set_has_a_picture_with_each_joint_at_a_place_of_its_own(name: str) -> None:
    places, is_person = joint_places(Skeleton(JOINT_SETS[name]))
    assert len(np.unique(places.round(3), axis=0)) == len(places)
    assert np.isfinite(places).all()
    assert is_person == (name not in ("mano-21", "interhand-42", "ap-10k"))


def test_a_tree_stands_with_its_root_on_top_and_children_below() -> None:
    places, is_person = joint_places(Skeleton(("a", "b", "c", "d"), (-1, 0, 0, 1)))
    assert not is_person
    assert places[:, 1].tolist() == [800, 0, 0, -800]
    assert places[0, 0] == 0
    assert places[1, 0] == places[3, 0] == -places[2, 0] == -800


def test_few_joints_of_a_person_make_no_person() -> None:
    assert not joint_places(Skeleton(("Hip", "a", "b", "c"), (-1, 0, 1, 1)))[1]
    assert joint_places(Skeleton(("Hip", "LHip", "a", "b"), (-1, 0, 1, 1)))[1]


def test_joints_between_others_stand_between_them() -> None:
    places, _ = joint_places(Skeleton(JOINT_SETS["smpl-24"]))
    at = dict(zip(JOINT_SETS["smpl-24"], places[:, 1], strict=True))
    assert at["pelvis"] < at["spine1"] < at["spine2"] < at["spine3"] < at["neck"] < at["head"]
    assert at["left_foot"] < at["left_ankle"] < at["left_knee"]


def test_numbers_stand_on_the_side_that_is_free() -> None:
    places = np.array([[0.0, 0], [10, 1], [30, 100], [-20, 100]])
    assert free_sides(places).tolist() == [-1, 1, 1, -1]


def test_without_signed_areas_there_is_no_picture_of_them(ax: Axes) -> None:
    with pytest.raises(PoseDataError, match=r"^metric: 'signed_area' was not measured\. Evaluate with "):
        signed_areas(report_of(metrics="mpjpe"), ax=ax)


# --- poses ----------------------------------------------------------------------------------------------------


def truth_ends(space: Axes3D) -> dict[str, np.ndarray]:
    """By bone: the ends of its blue line, (2, 3)."""
    return {
        str(line.get_gid()).removeprefix("truth "): np.stack(line.get_data_3d(), axis=1)  # type: ignore[attr-defined]
        for line in space.lines
        if str(line.get_gid()).startswith("truth ")
    }


@pytest.mark.parametrize("up", [(0, 0, 1), (0, -1, 0), (0, 1, 0), (1, 0, 0), (0, 0, -1), (-1, 0, 0)])
def test_people_stand_upright_whatever_their_axes(up: tuple[int, int, int], space: Axes3D) -> None:
    """A rotation that takes z to the axis that points up, as cameras and motion capture have it."""
    axis = int(np.abs(up).argmax())
    turned = np.roll(world().truth[0], axis + 1, axis=1)  # z goes to the axis
    turned[:, axis] *= sum(up)
    turned[:, (axis + 1) % 3] *= sum(up)
    poses(turned[None], turned, JOINTS, ax=space)
    bones = truth_ends(space)
    np.testing.assert_allclose(np.linalg.norm(np.diff(bones["RHip RKnee"], axis=0)), bone_length(turned), rtol=1e-6)
    assert bones["Neck/Nose Head"][1, 2] > bones["RHip RKnee"][0, 2] > bones["RKnee RFoot"][1, 2]


def bone_length(pose: np.ndarray) -> float:
    return float(np.linalg.norm(pose[JOINTS.index("RHip")] - pose[JOINTS.index("RKnee")]))


def test_turning_upright_does_not_mirror(space: Axes3D) -> None:
    """The triple product of three bones keeps its sign."""
    pose = world().truth[0][:, [2, 0, 1]]  # a rotation: z, x, y
    poses(pose[None], pose, JOINTS, ax=space)
    ends = truth_ends(space)
    names = ["RHip RKnee", "Thorax RShoulder", "Neck/Nose Head"]
    drawn = np.stack([np.diff(ends[name], axis=0)[0] for name in names])
    index = [[JOINTS.index(end) for end in name.split()] for name in names]
    given = np.stack([pose[child] - pose[parent] for parent, child in index])
    np.testing.assert_allclose(np.linalg.det(drawn), np.linalg.det(given), rtol=1e-6)


def test_hypotheses_are_thin_and_grey_behind_the_truth_and_one_joint_s_are_pink(space: Axes3D) -> None:
    here = world()
    assert poses(sample(here, 8)[:, 0], here.truth[0], JOINTS, cloud="RWrist", most=5, ax=space) is space
    (grey,) = (c for c in space.collections if c.get_gid() == "hypotheses")
    assert isinstance(grey, Line3DCollection)
    assert len(grey._segments3d) == 5 * 16  # type: ignore[attr-defined]
    (cloud,) = (c for c in space.collections if c.get_gid() == "cloud RWrist")
    assert to_hex(cloud.get_facecolor()[0]) == OVER.lower()
    assert len(cloud._offsets3d[0]) == 5
    assert len(truth_ends(space)) == 16
    assert {to_hex(line.get_color()) for line in space.lines} == {UNDER.lower()}  # type: ignore[arg-type]
    assert grey.get_zorder() < cloud.get_zorder() < min(line.get_zorder() for line in space.lines)


def test_the_cloud_lies_where_the_joint_s_hypotheses_are(space: Axes3D) -> None:
    here = world()
    hypotheses = sample(here, 6)[:, 0]
    poses(hypotheses, here.truth[0], JOINTS, cloud="LFoot", ax=space)
    (cloud,) = (c for c in space.collections if c.get_gid() == "cloud LFoot")
    drawn = np.stack(cloud._offsets3d, axis=1)
    np.testing.assert_allclose(
        np.linalg.norm(drawn, axis=1), np.linalg.norm(hypotheses[:, JOINTS.index("LFoot")], axis=1), rtol=1e-5
    )


def test_without_axes_new_ones_are_made() -> None:
    here = world()
    assert poses(sample(here, 3)[:, 0], here.truth[0], JOINTS).name == "3d"


def test_a_joint_that_is_not_finite_is_left_out(space: Axes3D) -> None:
    here = world()
    truth = here.truth[0].copy()
    truth[JOINTS.index("Head")] = np.nan
    poses(sample(here, 3)[:, 0], truth, JOINTS, ax=space)
    assert np.isnan(truth_ends(space)["Neck/Nose Head"][1]).all()
    assert np.isfinite(space.get_xlim() + space.get_zlim()).all()


@pytest.mark.parametrize(
    ("joints", "cloud", "truth", "words"),
    [
        (JOINTS, "RWrst", 0.0, r"^joint: 'RWrst' is not among the joints\. Did you mean RWrist\?$"),
        (JOINTS, None, np.nan, r"^pose: no joint with finite coordinates; expected some to draw\.$"),
    ],
)
def test_what_can_not_be_drawn_is_said(joints: list[str], cloud: str, truth: float, words: str, space: Axes3D) -> None:
    here = world()
    with pytest.raises(PoseDataError, match=words):
        poses(sample(here, 2)[:, 0], here.truth[0] + truth, joints, cloud=cloud, ax=space)


def test_joints_without_bones_are_points(space: Axes3D) -> None:
    here = world()
    poses(sample(here, 2)[:, 0], here.truth[0], [f"j{n}" for n in range(17)], ax=space)
    (truth,) = [found for found in space.collections if found.get_gid() == "truth of points"]
    assert len(truth._offsets3d[0]) == 17
    assert not space.lines


def test_poses_of_two_coordinates_are_drawn_flat_and_upright(ax: Axes) -> None:
    truth = np.array([[5.0, 90], [5, 50], [5, 10]])  # pixels: the second axis points down
    poses(truth + np.ones((3, 3, 2)), truth, ["Hip", "Thorax", "Head"], ax=ax)
    ends = {line.get_gid(): line.get_ydata().tolist() for line in ax.lines}
    assert ends == {"truth Hip Thorax": [-90.0, -50.0], "truth Thorax Head": [-50.0, -10.0]}
    with pytest.raises(PoseDataError, match=r"^truth: D = 1; expected 2 or 3 coordinates to draw\.$"):
        poses(truth[None, :, :1], truth[:, :1], ["Hip", "Thorax", "Head"], ax=ax)


def test_a_skeleton_of_ones_own_is_drawn(ax: Axes) -> None:
    truth = np.array([[5.0, 90], [5, 50], [5, 10]])
    poses(truth[None], truth, ["a", "b", "c"], parents=(-1, 0, 1), ax=ax)
    assert [line.get_gid() for line in ax.lines] == ["truth a b", "truth b c"]


# --- figures of poses -----------------------------------------------------------------------------------------


def test_frames_are_named_by_id_or_number_and_are_evenly_spaced_by_default() -> None:
    few = pairs()
    assert frames_of(few, "3, sequence 01/4,0") == [3, 4, 0]
    assert frames_of(few, None) == [3, 10, 18, 25, 32]  # the middles of fifths of 36
    assert frames_of(few, None, some=100) == list(range(36))


@pytest.mark.parametrize("said", ["36", "-1", "nobody", "1,,2", "1.5"])
def test_a_frame_that_is_not_there_is_refused(said: str) -> None:
    with pytest.raises(PoseDataError, match=r"is neither a frame id nor a number below 36\. The first are sequence 00"):
        frames_of(pairs(), said)


def test_each_frame_has_a_picture_with_its_name_and_the_legend_says_what_is_shown() -> None:
    figure = draw_poses(pairs(), [0, 7, 30], cloud="rwrist", most=4, columns=2)
    assert len(figure.axes) == 3
    said = [text.get_text() for text in figure.texts]
    assert said == [
        "sequence 00/0",
        "sequence 02/7",
        "sequence 10/30",
        "blue: truth · grey: 4 of 8 hypotheses · pink: RWrist",
    ]
    left, right, below = (place.get_position() for place in figure.axes)
    assert left.x0 < right.x0
    assert below.y0 < left.y0
    np.testing.assert_allclose(below.x0, left.x0)
