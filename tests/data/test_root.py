"""Roots: joints, midpoints and one for each part, as declared and as found by themselves."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest

import posecal
from posecal.data.root import Root, choose_root, parse_root, part_of_root, root_name
from posecal.data.skeleton import JOINT_SETS
from posecal.engine.coordinate_range import coordinate_range
from posecal.engine.scope import DataSpec
from posecal.errors import PoseDataError
from posecal.recalibration.maps import read_map, write_map
from posecal.recalibration.spread_map import SpreadMap

LSP = JOINT_SETS["lsp-14"]
HANDS = tuple(f"{side}_{name}" for side in "rl" for name in ("wrist", "thumb1", "thumb_tip"))


def arrays(joints: int, away: float = 3000.0) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(8)
    truth = rng.normal(0, 300, (9, joints, 3)) + rng.normal(0, 300, (9, 1, 3)) + [0, 0, away]
    return truth + rng.normal(0, 60, (5, 9, joints, 3)) + rng.normal(0, 90, (5, 9, 1, 3)), truth


def mpjpe(x: np.ndarray, y: np.ndarray) -> float:
    return float(np.linalg.norm(x - y, axis=-1).mean())


def about(poses: np.ndarray, joints: list[int]) -> np.ndarray:
    return poses - poses[..., joints, :].mean(axis=-2, keepdims=True)


@pytest.mark.parametrize("root_joint", [None, "LHip+RHip", "right_hip + left hip", "2+3"])
def test_the_midpoint_of_the_hips_is_subtracted(root_joint: str | None) -> None:
    x, y = arrays(14)
    report = posecal.evaluate(x, y, axes="NMKD", unit="mm", joints="lsp-14", root_joint=root_joint)
    assert report["mpjpe"] == pytest.approx(mpjpe(about(x, [2, 3]), about(y, [2, 3])))
    assert "14 joints" in report.definition("mpjpe")
    assert "root" not in report.definition("mpjpe")
    assert any("midpoint LHip+RHip" in remark for remark in report.remarks) == (root_joint is None)


def test_poses_about_the_hips_already_stay_as_they_are() -> None:
    x, y = arrays(14, away=0.0)
    x, y = x - y[:, 2:4].mean(axis=1, keepdims=True) + 20, y - y[:, 2:4].mean(axis=1, keepdims=True) + 20
    report = posecal.evaluate(x, y, axes="NMKD", unit="mm", joints="lsp-14")
    assert report["mpjpe"] == pytest.approx(mpjpe(x, y))
    assert any("no root joint is known" in remark for remark in report.remarks)


def test_each_part_has_a_root_of_its_own() -> None:
    x, y = arrays(6)
    expected = mpjpe(
        np.concatenate([about(x[:, :, :3], [0]), about(x[:, :, 3:], [0])], axis=2),
        np.concatenate([about(y[:, :3], [0]), about(y[:, 3:], [0])], axis=1),
    )
    report = posecal.evaluate(x, y, axes="NMKD", unit="mm", joints=HANDS, root_joint="RWrist,LWrist")
    assert report["mpjpe"] == pytest.approx(expected)
    assert "relative to r_wrist,l_wrist" in str(report)
    assert np.isnan([report.value("ece", joint=joint) for joint in ("r_wrist", "LWrist")]).all()


def test_two_hands_have_a_root_each_by_themselves() -> None:
    x, y = arrays(42)
    report = posecal.evaluate(x, y, axes="NMKD", unit="mm", joints="interhand-42")
    hands = [
        np.concatenate([about(poses[..., :21, :], [20]), about(poses[..., 21:, :], [20])], axis=-2) for poses in (x, y)
    ]
    assert report["mpjpe"] == pytest.approx(mpjpe(*hands))
    assert "relative to right_wrist,left_wrist" in str(report)
    y -= np.concatenate([y[:, [20]].repeat(21, axis=1), y[:, [41]].repeat(21, axis=1)], axis=1)
    assert posecal.PoseData(x, y, axes="NMKD", unit="mm", joints="interhand-42").root == report.totals.spec.root


def test_parts_follow_parents_before_sides() -> None:
    root = parse_root("a,b", ("a", "b", "left c", "d"), (-1, -1, 1, 2))
    assert root == Root(((0,), (1,)), (0, 1, 1, 1))
    with pytest.raises(PoseDataError, match=r"'a,b' leaves 1 joints without a root \(d\)"):
        parse_root("a,b", ("a", "b", "d"), (-1, -1, -1))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("LHip+RHop", r"^root_joint: 'LHip\+RHop: RHop' is not among the joints\. Did you mean RHip\?"),
        ("LHip+LHip", r"^root_joint: 'LHip\+LHip' names a joint more than once"),
        ("LHip,14", r"^root_joint: 'LHip,14: 14' is not among the joints"),
    ],
)
def test_roots_that_can_not_be_are_refused(text: str, words: str) -> None:
    with pytest.raises(PoseDataError, match=words):
        parse_root(text, LSP)


@pytest.mark.parametrize(
    ("name", "root"),
    [
        *[("mano-21", "wrist"), ("ap-10k", "Root of tail"), ("smpl-24", "pelvis"), ("panoptic-19", "BodyCenter")],
        ("interhand-42", "right_wrist,left_wrist"),
        *[("coco-17", "left_hip+right_hip"), ("3dhp-17", "pelvis"), ("h36m-32", "Hips"), ("mpii-16", "Hip")],
    ],
)
def test_a_joint_set_has_its_own_root(name: str, root: str) -> None:
    names = JOINT_SETS[name]
    _, y = arrays(len(names))
    found, remark = choose_root(None, names, y)
    assert sorted(root_name(found, names).split("+")) == sorted(root.split("+"))
    assert bool(remark) == (root not in ("pelvis", "Hip", "Hips", "BodyCenter"))


def test_a_root_that_only_the_truth_has_is_subtracted_from_it(tmp_path: Path) -> None:
    x, y = arrays(3)
    np.savez(tmp_path / "y.npz", truth=y, unit="mm", joints=("LHip", "RHip", "Head"))
    np.savez(tmp_path / "x.npz", hypotheses=x[:, :, 1:], unit="mm", joints=("RHip", "Head"))
    data = posecal.PoseData(tmp_path / "x.npz", tmp_path / "y.npz", shared_joints="common", root_joint="LHip+RHip")
    assert data.root is None
    np.testing.assert_allclose(data.truth, about(y, [0, 1])[:, 1:])
    assert any("lacks the root LHip+RHip" in remark for remark in data.remarks)


def test_a_root_is_kept_by_results_maps_and_chosen_joints(tmp_path: Path) -> None:
    root = Root(((0, 2), (1,)), (0, 1, 0))
    spec = DataSpec(3, ("a", "b", "c"), Root([[0, 2], [1]], [0, 1, 0]))  # type: ignore[arg-type]
    assert DataSpec(3, ("a", "b", "c"), asdict(spec)["root"]) == spec == DataSpec(3, ("a", "b", "c"), root)
    assert part_of_root(root, [1, 0, 2]) == Root(((1, 2), (0,)), (1, 0, 0))
    assert part_of_root(root, [0, 1]) is None
    write_map(SpreadMap(LSP, np.full(14, 2.0), 10, 2, parse_root("LHip+RHip", LSP)), tmp_path / "map.json")
    assert read_map(tmp_path / "map.json").root == Root(((3, 2),))
    report = posecal.evaluate(*arrays(14), axes="NMKD", unit="mm", joints="lsp-14")
    report.save(tmp_path / "r.npz")
    loaded = posecal.Report(posecal.load_totals(tmp_path / "r.npz"))
    assert (loaded.signature, loaded.totals.spec) == (report.signature, report.totals.spec)
    assert "origin=LHip+RHip" in loaded.signature


def test_the_coordinate_range_is_relative_to_the_root() -> None:
    _, y = arrays(6)
    root = Root(((0,), (3,)), (0, 0, 0, 1, 1, 1))
    parts = np.concatenate([about(y[:, :3], [0]), about(y[:, 3:], [0])], axis=1)
    np.testing.assert_allclose(coordinate_range(y, root=root).least[0], parts.min(axis=0))


def test_factors_spread_hypotheses_about_their_median_relative_to_the_root() -> None:
    x, _ = arrays(3)
    map_ = SpreadMap(("LHip", "RHip", "Head"), np.array([1.0, 1, 3]), 10, 2, Root(((0, 1),)))
    moved = about(map_.apply(x, axes="NMKD"), [0, 1])[:, :, 2]
    relative = about(x, [0, 1])[:, :, 2]
    middle = np.median(relative, axis=0)
    np.testing.assert_allclose(moved, middle + 3 * (relative - middle), atol=1e-6)


def test_poses_of_which_a_hip_does_not_count_are_left_out() -> None:
    x, y = arrays(14)
    where = np.ones((9, 14), dtype=bool)
    where[4, 3] = False
    y[4, 3] = np.nan
    report = posecal.evaluate(x, y, where=where, axes="NMKD", unit="mm", joints="lsp-14", root_joint="LHip+RHip")
    kept = np.arange(9) != 4
    assert report["mpjpe"] == pytest.approx(mpjpe(about(x[:, kept], [2, 3]), about(y[kept], [2, 3])))
    assert any("the root LHip+RHip does not count in 1 of 9 frames (first: 4)" in remark for remark in report.remarks)


def test_hypotheses_without_the_pelvis_that_lie_elsewhere_are_about_the_hips(tmp_path: Path) -> None:
    x, y = arrays(4)
    names = ("Hip", "LHip", "RHip", "Head")
    np.savez(tmp_path / "y.npz", truth=y, unit="mm", joints=names)
    np.savez(tmp_path / "x.npz", hypotheses=x[:, :, 1:], unit="mm", joints=names[1:])
    data = posecal.PoseData(tmp_path / "x.npz", tmp_path / "y.npz", shared_joints="common")
    assert data.root == Root(((0, 1),))
    assert any("lacks the root Hip; no pelvis is named, so poses are relative to" in text for text in data.remarks)
    np.savez(tmp_path / "x.npz", hypotheses=about(x[:, :, 1:], [0, 1]) + 9, unit="mm", joints=names[1:])
    data = posecal.PoseData(tmp_path / "x.npz", tmp_path / "y.npz", shared_joints="common")
    assert data.root is None
    np.testing.assert_allclose(data.truth, about(y, [0])[:, 1:])
    assert any("its positions are taken as relative to it" in text for text in data.remarks)


@pytest.mark.parametrize(("away", "is_taken"), [(0.2, False), (0.4, True)])
def test_poses_whose_hips_lie_nearer_than_a_part_of_their_size_are_about_them(away: float, *, is_taken: bool) -> None:
    _, y = arrays(14)
    y = about(y, [2, 3])
    y += np.array([0, away * np.median(np.linalg.norm(y, axis=-1)), 0])
    assert (choose_root(None, LSP, y)[0] is not None) == is_taken


def test_parts_are_numbered_as_they_are_named() -> None:
    assert parse_root("b,a", ("a", "b", "c"), (-1, -1, 0)) == Root(((1,), (0,)), (1, 0, 1))


def test_a_part_of_a_joint_set_has_not_its_root() -> None:
    assert choose_root(None, ("index1", "wrist", "pinky3"), arrays(3)[1])[0] is None


def test_pixels_have_the_root_that_a_skeleton_names_and_no_other() -> None:
    x, y = (poses[..., :2] for poses in arrays(3))
    skeleton = {"names": ["a", "b", "c"], "parents": [-1, 0, 1]}
    assert posecal.PoseData(x, y, unit="px", axes="NMKD", skeleton=skeleton).root is None
    assert posecal.PoseData(x, y, unit="px", axes="NMKD", skeleton={**skeleton, "root": "b"}).root == 1
