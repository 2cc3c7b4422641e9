"""Central intervals over time: their ends, the truths outside, names and units."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure

import posecal
from posecal.data.pose_data import PoseData
from posecal.errors import PoseDataError
from posecal.plot import draw_intervals, intervals
from tests.helpers.shell import run

Array = np.ndarray[Any, Any]
N, M = 39, 30  # ranks 2 and 38, 10 and 30


def angles(centre: float = 0.0) -> tuple[Array, Array]:
    random = np.random.default_rng(0)
    middle = centre + 30 * np.sin(np.arange(M) / 5)
    return middle + random.normal(0, 10, (N, M)), middle + random.normal(0, 10, M)


def band(ax: Axes, name: str, frames: int = M) -> Array:
    """The ends of a filled interval at each frame, (M, 2)."""
    (found,) = (c for c in ax.collections if c.get_gid() == name)
    points = np.asarray(found.get_paths()[0].vertices)
    return np.array(
        [[points[points[:, 0] == at, 1].min(), points[points[:, 0] == at, 1].max()] for at in range(frames)]
    )


def line(ax: Axes, name: str) -> Array:
    (found,) = (each for each in ax.lines if each.get_gid() == name)
    return np.asarray(found.get_xydata())


def test_bands_end_at_the_ranks_of_their_level_and_truths_outside_are_marked() -> None:
    x, y = angles()
    ax = intervals(x, y, ax=Figure().add_subplot())
    rising = np.sort(x, axis=0)
    np.testing.assert_allclose(band(ax, "90 % interval"), rising[[1, 37]].T)
    np.testing.assert_allclose(band(ax, "50 % interval"), rising[[9, 29]].T)
    outside = (y < rising[1]) | (y > rising[37])
    np.testing.assert_allclose(line(ax, "outside"), np.stack([np.arange(M), y], axis=1)[outside])
    np.testing.assert_allclose(line(ax, "truth")[:, 1], y)
    assert ax.get_title() == f"{100 * (1 - outside.mean()):.0f} % within the 90 % interval"


@pytest.mark.parametrize("write", [lambda a: (a + 180) % 360 - 180, lambda a: a % 360])
def test_angles_are_drawn_without_jumps(write: Any) -> None:
    x, y = angles(175)
    plain, wrapped = (Figure().add_subplot() for _ in range(2))
    intervals(x, y, ax=plain)
    intervals(write(x), write(y), unit="deg", ax=wrapped)
    turns = line(wrapped, "truth")[:, 1] - y
    assert np.ptp(turns) < 1e-9
    assert turns[0] / 360 == pytest.approx(round(turns[0] / 360), abs=1e-12)
    np.testing.assert_allclose(band(wrapped, "90 % interval") - turns[0], band(plain, "90 % interval"), atol=1e-9)


def test_few_hypotheses_have_the_interval_that_they_span() -> None:
    x, y = angles()
    ax = intervals(x[:9], y, ax=Figure().add_subplot())
    np.testing.assert_allclose(band(ax, "80 % interval"), np.sort(x[:9], axis=0)[[0, -1]].T)
    assert ax.get_title().endswith("% within the 80 % interval")


def test_frames_that_do_not_count_are_gaps() -> None:
    x, y = angles()
    x[:, 4], y[7] = np.nan, np.nan
    ax = intervals(x, y, unit="deg", ax=Figure().add_subplot())
    assert np.flatnonzero(np.isnan(line(ax, "truth")[:, 1])).tolist() == [4, 7]


# --- of data ------------------------------------------------------------------------------------------------------


def walk(**options: Any) -> PoseData:
    random = np.random.default_rng(1)
    y = random.normal(0, 200, (M, 3, 3))
    labels = {"sequence": np.repeat(["a", "b", "c"], M // 3)}
    x = y + random.normal(0, 30, (N, M, 3, 3))
    described = {"axes": "NMKD", "unit": "mm", "joints": ["Hip", "RKnee", "RWrist"], "root_joint": "Hip"}
    return PoseData(x, y, labels=labels, **described, **options)


def panels(figure: Figure) -> list[Axes]:
    return [ax for ax in figure.axes if ax.axison]


def test_a_position_is_drawn_as_it_is_evaluated_and_labelled_with_its_unit() -> None:
    data = walk()
    figure = draw_intervals(data, joint="RWrist", coordinate="z", sequence="b")
    (ax,) = panels(figure)
    true = (data.truth[:, 2] - data.truth[:, 0])[10:20, 2]
    np.testing.assert_allclose(line(ax, "truth"), np.stack([np.arange(10), true], axis=1))
    x = data.hypotheses.read(10, 20)
    rising = np.sort(x[:, :, 2, 2] - x[:, :, 0, 2], axis=0)
    np.testing.assert_allclose(band(ax, "90 % interval", 10), rising[[1, 37]].T)
    assert figure.get_supylabel() == "RWrist, z relative to Hip [mm]"
    assert ax.get_title().startswith("b\n")
    assert ax.get_xlabel() == "frame"
    assert figure.legends[0].get_texts()[0].get_text() == "90 % interval"


def test_the_first_joint_coordinate_and_sequence_are_drawn_where_none_is_named() -> None:
    figure = draw_intervals(walk(fps=50.0))
    (ax,) = panels(figure)
    assert figure.get_supylabel() == "RKnee, x relative to Hip [mm]"
    assert ax.get_xlabel() == "time [s]"
    np.testing.assert_allclose(line(ax, "truth")[:, 0], np.arange(10) / 50)


def test_all_sequences_stand_side_by_side_and_a_size_is_taken() -> None:
    figure = draw_intervals(walk(), sequence="all", columns=2, size=(7, 4))
    assert [ax.get_title().partition("\n")[0] for ax in panels(figure)] == ["a", "b", "c"]
    assert figure.get_size_inches().tolist() == [7, 4]
    assert [ax.get_xlabel() for ax in panels(figure)] == ["", "frame", "frame"]


def test_without_sequences_all_frames_are_drawn_up_to_the_largest_size() -> None:
    y = np.random.default_rng(2).normal(0, 9, (M, 4, 2))
    data = PoseData(y + np.ones((N, 1, 1, 1)), y, unit="px", axes="NMKD")
    figure = draw_intervals(data, joint="1", coordinate="1", size=(40, 0.5))
    (ax,) = panels(figure)
    np.testing.assert_allclose(line(ax, "truth")[:, 1], y[:, 1, 1])
    assert ax.get_title() == "0 % within the 90 % interval"
    assert figure.get_supylabel() == "joint 1, y [px]"


def test_a_masked_joint_is_not_drawn() -> None:
    where = np.ones((M, 3), dtype=bool)
    where[3, 1] = False
    (ax,) = panels(draw_intervals(walk(where=where)))
    assert np.flatnonzero(np.isnan(line(ax, "truth")[:, 1])).tolist() == [3]


@pytest.mark.parametrize(
    ("unit", "label"), [("deg", "knee [deg]"), ("rad", "knee [deg]"), ("px", "knee [px]"), ("none", "knee")]
)
def test_one_coordinate_has_the_name_of_its_joint(unit: str, label: str) -> None:
    x, y = (array.reshape(*array.shape, 1, 1) for array in angles())
    figure = draw_intervals(PoseData(x, y, unit=unit, joints=["knee"]))
    assert figure.get_supylabel() == label
    assert panels(figure)[0].get_title().startswith(("9", "8", "100"))


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"joint": "Tail"}, r"joint: 'Tail' is not among the joints"),
        ({"coordinate": "w"}, r"coordinate: 'w'; expected one of x, y, z, or its number"),
        ({"coordinate": "3"}, r"coordinate: '3'; expected one of x, y, z"),
        ({"size": (6, 0)}, r"size: \(6, 0\); expected inches across and down, above 0 and at most 40"),
        ({"size": (float("nan"), 3)}, r"size: \(nan, 3\); expected inches"),
        ({"sequence": "a,d"}, r"sequence: 'd' is not known\. The first are a, b, c"),
    ],
)
def test_what_can_not_be_drawn_is_refused(options: dict[str, Any], words: str) -> None:
    with pytest.raises(PoseDataError, match=words):
        draw_intervals(walk(), **options)


def test_a_sequence_is_refused_where_the_data_have_none() -> None:
    x, y = (array.reshape(*array.shape, 1, 1) for array in angles())
    with pytest.raises(PoseDataError, match=r"sequence: 'a'; expected none, since the truth has no label sequence"):
        draw_intervals(posecal.PoseData(x, y, unit="deg"), sequence="a")


def test_the_command_draws_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    x, y = (array.reshape(*array.shape, 1, 1) for array in angles())
    np.savez("hyps.npz", hypotheses=x, axes="NMKD", unit="deg", joints=["knee"])
    np.savez("gt.npz", truth=y, unit="deg", joints=["knee"], sequence=np.repeat(["left", "right"], M // 2))
    done = run("plot", "intervals", "hyps.npz", "gt.npz", "--sequence", "all", "--size", "6", "3", "-o", "knee.svg")
    assert done.exit_code == 0, done.output
    text = Path("knee.svg").read_text(encoding="utf-8")
    for words in ("knee [deg]", "left", "right", "90 % interval", "truth outside", 'width="432pt" height="216pt"'):
        assert words in text
    done = run("plot", "intervals", "hyps.npz", "gt.npz", "--joint", "hip", "-o", "no.svg")
    assert (done.exit_code, Path("no.svg").exists()) == (3, False)
    assert run("plot", "intervals", "hyps.npz", "gt.npz", "--size", "6", "-3", "-o", "no.svg").exit_code == 2
