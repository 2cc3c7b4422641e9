"""Hypotheses that were recalibrated on the poses of their evaluation are remarked on."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import posecal
from posecal.data.fitted_poses import MOST, fitted_hashes, fitted_remarks, row_hashes
from posecal.recalibration import apply_map, read_map, write_map

JOINTS = ["Hip", "Head", "LFoot", "RFoot"]


def poses(m: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).normal(0, 300, (m, 4, 3))


def world(tmp_path: Path, m: int = 40) -> tuple[Path, Path]:
    """Write a narrow sampler and its truth."""
    truth = poses(m)
    hypotheses = truth + np.random.default_rng(1).normal(0, 60, truth.shape)
    hypotheses = hypotheses + np.random.default_rng(2).normal(0, 30, (20, *truth.shape))
    about = {"joints": JOINTS, "unit": "mm"}
    np.savez(tmp_path / "narrow.npz", hypotheses=hypotheses, axes="NMKD", **about)
    np.savez(tmp_path / "truth.npz", truth=truth, sequence=np.repeat(np.arange(10), m // 10), **about)
    return tmp_path / "narrow.npz", tmp_path / "truth.npz"


def said(remarks: tuple[str, ...]) -> list[str]:
    return [remark for remark in remarks if "recalibrated by a map" in remark]


def test_poses_of_the_fit_are_counted() -> None:
    some = poses(50)
    (remark,) = fitted_remarks(fitted_hashes(some[:20]), some[10:], "new.npz")
    assert remark.startswith(
        "new.npz: recalibrated by a map that was fitted on poses of this evaluation (10 of 40 frames): "
    )


def test_other_poses_get_no_remark() -> None:
    some = poses(50)
    assert fitted_remarks(fitted_hashes(some[:20]), some[20:], "new.npz") == []
    assert fitted_remarks(None, some, "new.npz") == []


def test_of_many_poses_a_sample_finds_them() -> None:
    some = poses(4000)
    hashes = fitted_hashes(some[:2000])
    assert len(hashes) == MOST
    assert (np.diff(hashes.astype(object)) > 0).all()
    (remark,) = fitted_remarks(hashes, some, "new.npz")
    assert "(about " in remark
    number = int(remark.split("about ")[1].split(" ")[0].replace(",", ""))
    assert abs(number - 2000) < 4 * 4000 * (0.25 / (2 * MOST)) ** 0.5  # a binomial's deviation, with p = 1/2


def test_poses_of_few_coordinates_are_not_known() -> None:
    angles = poses(30)[:, :2]
    assert not len(fitted_hashes(angles))


def test_equal_texts_of_any_width_have_one_hash() -> None:
    narrow, wide = np.array(["a", "b"]), np.array(["a", "b"], dtype="U9")
    assert row_hashes(narrow).tolist() == row_hashes(wide).tolist()
    assert len({*row_hashes(narrow).tolist()}) == 2


def test_a_file_that_a_map_wrote_is_known_in_evaluation_and_comparison(tmp_path: Path) -> None:
    narrow, truth = world(tmp_path)
    write_map(posecal.fit_spread(narrow, truth), tmp_path / "map.json")
    apply_map(read_map(tmp_path / "map.json"), narrow, tmp_path / "wide.npz")
    data = posecal.PoseData(tmp_path / "wide.npz", truth)
    assert len(said(data.remarks)) == len(said(posecal.evaluate(data).remarks)) == 1
    assert "(40 of 40 frames)" in said(data.remarks)[0]
    compared = posecal.compare({"narrow": narrow, "wide": tmp_path / "wide.npz"}, truth)
    (remark,) = said(compared.remarks)
    assert remark.startswith("wide: wide.npz: recalibrated by")


def test_pose_data_that_are_rescaled_are_known(tmp_path: Path) -> None:
    data = posecal.PoseData(*world(tmp_path))
    odd, even = (data.select(np.arange(start, 40, 2)) for start in (1, 0))
    spread_map = posecal.fit_spread(odd)
    assert not said(spread_map.rescale(even).remarks)
    assert "20 of 40 frames" in said(spread_map.rescale(data).remarks)[0]


def test_of_two_maps_the_poses_of_both_are_known(tmp_path: Path) -> None:
    narrow, truth = world(tmp_path)
    data = posecal.PoseData(narrow, truth)
    source = narrow
    for number in (0, 1):
        half = data.select(np.arange(number, 40, 2))
        apply_map(posecal.fit_spread(half), source, tmp_path / f"{number}.npz")
        source = tmp_path / f"{number}.npz"
    assert "40 of 40 frames" in said(posecal.PoseData(source, truth).remarks)[0]


def test_a_member_of_that_name_that_is_something_else_is_refused(tmp_path: Path) -> None:
    narrow, truth = world(tmp_path)
    with np.load(narrow) as stored:
        np.savez(tmp_path / "other.npz", **stored, recalibrated_on=np.zeros(3))
    with pytest.raises(posecal.PoseDataError, match=r"recalibrated_on: float64 \(3,\); expected hashes"):
        posecal.PoseData(tmp_path / "other.npz", truth)
