"""Poses: upright, with each joint where it belongs, the worst frames first."""

from collections.abc import Iterator
from typing import cast

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d import proj3d
from mpl_toolkits.mplot3d.art3d import Line3DCollection
from mpl_toolkits.mplot3d.axes3d import Axes3D

import posecal
from posecal.data.pose_data import PoseData
from posecal.demo import sample
from posecal.errors import PoseDataError
from posecal.plot import caption_of, draw_poses, frames_of, poses
from posecal.plot.pose_figures import LEFT
from posecal.plot.style import OVER, UNDER
from tests.helpers.reports import world

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


def test_frames_are_named_by_id_or_number_or_evenly_spaced() -> None:
    few = pairs()
    assert frames_of(few, "3, sequence 01/4,0") == [3, 4, 0]
    assert frames_of(few, "even") == [3, 10, 18, 25, 32]  # the middles of fifths of 36
    assert frames_of(few, "even", some=100) == list(range(36))


def errors_of(data: PoseData) -> np.ndarray:
    """Of each pose the smallest mean distance of a hypothesis, by plain loops."""
    whole = data.hypotheses.read(0, len(data.truth))
    found = []
    for pose, truth in enumerate(data.truth):
        means = []
        for hypothesis in whole[:, pose]:
            means.append(np.mean([np.linalg.norm(a - b) for a, b in zip(hypothesis, truth, strict=True)]))
        found.append(min(means))
    return np.array(found)


def test_the_worst_frames_are_the_default_one_of_each_sequence_first(monkeypatch: pytest.MonkeyPatch) -> None:
    here = world()
    data = PoseData(
        sample(here, 3), here.truth, labels={"sequence": here.sequence}, axes="NMKD", unit="mm", joints=JOINTS
    )
    errors = errors_of(data)
    worst = [
        max(np.flatnonzero(here.sequence == name), key=lambda k: errors[k]) for name in dict.fromkeys(here.sequence)
    ]
    worst.sort(key=lambda k: -errors[k])
    monkeypatch.setattr("posecal.plot.pose_figures.NUMBERS_AT_ONCE", 700)  # four poses of 3 × 17 × 3 numbers at once
    assert frames_of(data) == worst[:5] == frames_of(data, "worst")
    others = [k for k in np.argsort(-errors) if k not in worst]
    assert frames_of(data, some=20) == [*worst, *others][:20]
    assert frames_of(pairs()) == list(np.argsort(-errors_of(pairs()))[:5])  # without sequences


@pytest.mark.parametrize("said", ["36", "-1", "nobody", "1,,2", "1.5"])
def test_a_frame_that_is_not_there_is_refused(said: str) -> None:
    with pytest.raises(PoseDataError, match=r"is neither a frame id nor a number below 36\. The first are sequence 00"):
        frames_of(pairs(), said)


def test_each_frame_has_a_picture_with_its_name_and_the_legend_says_what_is_shown() -> None:
    figure = draw_poses(pairs(), [0, 7, 30], cloud="rwrist", most=4, columns=2)
    assert len(figure.axes) == 3
    errors = errors_of(pairs())
    said = [text.get_text() for text in figure.texts]
    assert said == [
        *(f"{pairs().frame_id[frame]}\n{errors[frame]:.3g} mm" for frame in (0, 7, 30)),
        "truth: blue, its left side light · hypotheses: grey, 4 of 8 · RWrist: pink",
    ]
    assert "Frames sequence 00/0, sequence 02/7, sequence 10/30, from azimuth -62° and elev" in caption_of(figure)
    left, right, below = (place.get_position() for place in figure.axes)
    assert left.x0 < right.x0
    assert below.y0 < left.y0
    np.testing.assert_allclose(below.x0, left.x0)


def test_a_pose_stands_on_its_floor_with_its_left_side_light(space: Axes3D) -> None:
    here = world()
    poses(sample(here, 4)[:, 0], here.truth[0], JOINTS, ax=space, view=(30, 20))
    (floor,) = (c for c in space.collections if c.get_gid() == "floor")
    corners = np.asarray(floor._faces[0] if hasattr(floor, "_faces") else floor._vec[:3].T)  # type: ignore[attr-defined]
    np.testing.assert_allclose(corners[:, 2], here.truth[0][:, 2].min())
    assert (space.azim, space.elev) == (30, 20)
    for line in space.lines:
        end = str(line.get_gid()).split()[-1]
        assert line.get_color() == (LEFT if end.startswith("L") else UNDER)


@pytest.mark.parametrize("size", [(8.5, 2.6), (3.3, 4.0)])
def test_no_head_or_foot_of_the_truth_lies_outside_its_picture(size: tuple[float, float]) -> None:
    figure = draw_poses(pairs(), [0, 7, 30], columns=3, size=size)
    FigureCanvasAgg(figure).draw()
    for ax in figure.axes:
        for line in ax.lines:
            x, y, _ = proj3d.proj_transform(*line.get_data_3d(), ax.get_proj())  # type: ignore[attr-defined]
            at = ax.transData.transform(np.stack([x, y], axis=1))
            assert (at >= 0).all()
            assert (at <= [figure.bbox.width, figure.bbox.height]).all()


def test_joints_that_do_not_count_are_not_in_the_error() -> None:
    here = world()
    where = np.ones(here.truth.shape[:2], dtype=bool)
    where[:, 3:] = False
    x = np.repeat(here.truth[None], 2, axis=0)
    x[:, :, 3:] += 500
    x[:, 5, 1] += 30  # one of three joints that count
    data = PoseData(x, here.truth, where=where, axes="NMKD", unit="mm", joints=JOINTS)
    assert frames_of(data, some=1) == [5]
    assert draw_poses(data, [5]).texts[0].get_text() == f"5\n{np.sqrt(3) * 30 / 3:.3g} mm"
