"""Log densities beside hypotheses are read, turned into the unit that is measured in, or refused."""

import math
from pathlib import Path

import numpy as np
import pytest

import posecal
from posecal.data.log_density import as_dimensions, number_of_coordinates
from posecal.data.root import Root
from posecal.errors import PoseDataError

N, M, K = 4, 6, 5
X, Y = np.random.default_rng(0).normal(0, 300, (N, M, K, 3)), np.random.default_rng(1).normal(0, 300, (M, K, 3))
LOG_PROB = np.arange(M) - 60.0


def data(**options: object) -> posecal.PoseData:
    return posecal.PoseData(X, Y, **{"unit": "mm", "log_prob": LOG_PROB, **options})


@pytest.mark.parametrize(("unit", "factor"), [("mm", 1.0), ("cm", 10.0), ("m", 1000.0), ("1/0.5", 2.0)])
def test_a_density_is_turned_into_one_of_millimetres(unit: str, factor: float) -> None:
    found = posecal.PoseData(X / factor, Y / factor, unit=unit, log_prob=LOG_PROB, root_joint=0)
    assert found.dimensions == 12
    np.testing.assert_allclose(found.log_prob, LOG_PROB - 12 * math.log(factor))


def test_angles_in_radians_have_densities_in_degrees() -> None:
    found = posecal.PoseData(X[..., :1] / 300, Y[..., :1] / 300, unit="rad", log_prob=LOG_PROB)
    np.testing.assert_allclose(found.log_prob, LOG_PROB - 5 * math.log(180 / math.pi))


@pytest.mark.parametrize(("root", "dimensions"), [(0, 12), ("none", 15)])
def test_the_density_is_over_the_joints_that_are_not_the_root(root: object, dimensions: int) -> None:
    assert data(root_joint=root).dimensions == dimensions


def test_roots_of_parts_are_no_coordinates_and_midpoints_are_none_of_the_joints() -> None:
    assert number_of_coordinates(7, 3, Root(((0,), (3,)), (0, 0, 0, 1, 1, 1, 1))) == 15
    assert number_of_coordinates(7, 2, Root(((1, 4),))) == 14


def test_the_number_of_coordinates_can_be_declared() -> None:
    found = posecal.PoseData(X / 1000, Y / 1000, unit="m", log_prob=LOG_PROB, dimensions=9)
    assert found.dimensions == 9
    np.testing.assert_allclose(found.log_prob, LOG_PROB - 9 * math.log(1000))
    for wrong in (0, 2.5, [3, 4], "x"):
        with pytest.raises(PoseDataError, match=r"dimensions: "):
            data(dimensions=wrong)
    with pytest.raises(PoseDataError, match=r"^hypotheses: dimensions = 9 without log_prob; expected both, or neither"):
        posecal.PoseData(X, Y, unit="mm", dimensions=9)
    assert as_dimensions(np.array([48]), "dimensions") == 48


def test_a_number_of_coordinates_that_the_poses_have_not_is_remarked_on() -> None:
    for dimensions, is_said in ((15, False), (12, True), (48, True)):
        remarks = data(root_joint="none", dimensions=dimensions).remarks
        words = (
            f"NLL: dimensions = {dimensions} is declared, and the poses have 15 coordinates without the root (5 joints"
        )
        assert any(remark.startswith(words) for remark in remarks) is is_said


def test_without_a_density_there_is_none() -> None:
    found = posecal.PoseData(X, Y, unit="mm")
    assert (found.log_prob, found.dimensions) == (None, 0)


@pytest.mark.parametrize("values", [np.zeros(M - 1), np.zeros((1, M)), ["a"] * M, np.zeros(M, dtype=complex)])
def test_other_shapes_and_types_are_refused(values: object) -> None:
    with pytest.raises(PoseDataError, match=r"log_prob.*expected"):
        data(log_prob=values)


def test_what_is_not_finite_is_refused_with_the_first_frames() -> None:
    values = LOG_PROB.copy()
    values[[1, 4]] = np.nan
    with pytest.raises(
        PoseDataError, match=r"log_prob is not finite in 2 of 6 frames \(first: 1, 4\); expected nats\. Give"
    ):
        data(log_prob=values)
    values[4] = -np.inf
    with pytest.raises(PoseDataError, match=r"An infinite log density makes the NLL of all poses infinite\."):
        data(log_prob=values)


def test_a_file_s_members_are_matched_by_frame_id(tmp_path: Path) -> None:
    names, order = np.array(list("abcdef")), np.array([3, 1, 5, 0, 2, 4])
    np.savez(tmp_path / "h.npz", hypotheses=X / 1000, unit="m", log_prob=LOG_PROB, dimensions=15, frame_id=names)
    np.savez(tmp_path / "t.npz", truth=Y[order] / 1000, unit="m", frame_id=names[order])
    found = posecal.PoseData(tmp_path / "h.npz", tmp_path / "t.npz")
    np.testing.assert_allclose(found.log_prob, LOG_PROB[order] - 15 * math.log(1000))
    assert found.dimensions == 15
    assert not [remark for remark in found.remarks if "log_prob" in remark or "dimensions" in remark]


def test_an_argument_goes_before_a_file_s_member(tmp_path: Path) -> None:
    np.savez(tmp_path / "h.npz", hypotheses=X, unit="mm", log_prob=LOG_PROB)
    np.testing.assert_array_equal(posecal.PoseData(tmp_path / "h.npz", Y).log_prob, LOG_PROB)
    np.testing.assert_array_equal(posecal.PoseData(tmp_path / "h.npz", Y, log_prob=LOG_PROB - 1).log_prob, LOG_PROB - 1)


def test_frames_that_are_not_valid_may_have_none(tmp_path: Path) -> None:
    values, valid = LOG_PROB.copy(), np.ones(M, dtype=bool)
    values[2], valid[2] = np.nan, False
    np.savez(tmp_path / "t.npz", truth=Y, unit="mm", valid=valid)
    found = posecal.PoseData(X, tmp_path / "t.npz", unit="mm", log_prob=values)
    np.testing.assert_array_equal(found.log_prob, LOG_PROB[valid])


def test_poses_of_which_a_joint_does_not_count_may_have_none() -> None:
    values, where = LOG_PROB.copy(), np.ones((M, K), dtype=bool)
    values[2], where[2, 3], where[4, 1] = np.nan, False, False
    found = data(log_prob=values, where=where)
    np.testing.assert_array_equal(found.log_prob, np.where(where.all(axis=1), LOG_PROB, np.nan))
    assert "NLL: 2 poses lack a joint; left out of it." in found.remarks
    values[3] = np.nan
    with pytest.raises(PoseDataError, match=r"log_prob is not finite in 1 of 6 frames \(first: 3\)"):
        data(log_prob=values, where=where)


def test_of_a_part_of_the_joints_there_is_none_unless_dimensions_says_so(tmp_path: Path) -> None:
    np.savez(tmp_path / "h.npz", hypotheses=X, unit="mm", log_prob=LOG_PROB, joints=list("abcde"))
    np.savez(tmp_path / "t.npz", truth=Y[:, :4], unit="mm", joints=list("abcd"))
    files = tmp_path / "h.npz", tmp_path / "t.npz"
    found = posecal.PoseData(*files, shared_joints="common", root_joint="a")
    assert (found.log_prob, found.dimensions) == (None, 0)
    assert (
        "NLL: left out, because log_prob is of 5 joints, of which 4 are evaluated. Declare dimensions where it is of "
        "others." in found.remarks
    )
    declared = posecal.PoseData(*files, shared_joints="common", root_joint="a", dimensions=9)
    np.testing.assert_array_equal(declared.log_prob, LOG_PROB)
    assert declared.dimensions == 9


def test_selected_poses_keep_theirs() -> None:
    np.testing.assert_array_equal(data().select([4, 1]).log_prob, LOG_PROB[[4, 1]])


def test_other_hypotheses_of_the_same_poses_have_none() -> None:
    assert posecal.climatology(data()).log_prob is None
    spread_map = posecal.recalibration.SpreadMap(tuple(f"joint {k}" for k in range(K)), np.full(K, 2.0), M, M)
    rescaled = spread_map.rescale(data())
    assert (rescaled.log_prob, rescaled.dimensions) == (None, 0)
