"""Signed areas on a skeleton: a disc per joint, where the joint belongs."""

from collections.abc import Iterator

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.colors import to_hex
from matplotlib.figure import Figure

import posecal
from posecal.data.skeleton import JOINT_SETS, Skeleton
from posecal.errors import PoseDataError
from posecal.plot import draw, signed_areas
from posecal.plot.layout import free_sides, joint_places
from posecal.plot.style import OVER, UNDER
from tests.helpers.reports import report_of, unlabelled

JOINTS = posecal.JOINT_SETS["h36m-17"]


@pytest.fixture
def ax() -> Axes:
    return Figure().add_subplot()


@pytest.fixture(autouse=True)
def _no_figure_is_left() -> Iterator[None]:
    from matplotlib import pyplot as plt

    yield
    plt.close("all")


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
        assert f"{report.value('signed_area', joint=name):+.2f}".replace("-", "−") in shown


def test_no_number_lies_on_a_disc() -> None:
    figure = draw(report_of(0.2), "joints")  # all are overconfident: large discs, and a sign before each number
    figure.draw_without_rendering()
    (ax,) = figure.axes
    numbers = [text.get_window_extent() for text in ax.texts if text.get_text().startswith("−")]
    assert len(numbers) == len(JOINTS) - 1
    for name, (area, _, place) in discs(ax).items():
        across, up = ax.transData.transform(place)
        radius = np.sqrt(area / np.pi) * figure.dpi / 72
        for box in numbers:
            away = np.hypot(across - np.clip(across, box.x0, box.x1), up - np.clip(up, box.y0, box.y1))
            assert away > radius, name


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
