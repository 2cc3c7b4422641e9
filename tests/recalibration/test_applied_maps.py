"""Maps are applied to files of hypotheses, whole or not at all; other files are refused."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from posecal.data.alone import resolve_hypotheses
from posecal.data.declarations import Declarations
from posecal.data.read import read_poses
from posecal.errors import PoseDataError
from posecal.recalibration import RadiusMap, SpreadMap, apply_map, maps, write_map
from posecal.recalibration.spread_map import rescaled
from tests.helpers.random_worlds import skewed

Array = np.ndarray
JOINTS = ("Hip", "Head", "LFoot")
SPREAD = SpreadMap(JOINTS, np.array([1.0, 0.7, 2.125]), 120, 6, 0)
RADIUS = RadiusMap(JOINTS, np.array([math.nan, 80.5, 120.25]), 0.1, False, 120, 6)

X = skewed(1, 5, 11, 3)[0].astype("f4")
FRAMES = [f"f{m}" for m in range(11)]


def applied(map_: SpreadMap | RadiusMap, folder: Path, x: Array = X, name: str = "out.npz", **how: Any) -> Path:
    """Apply to hypotheses in a file."""
    np.savez(folder / "hyps.npz", hypotheses=x, axes="NMKD", unit="mm", joints=JOINTS, frame_id=FRAMES)
    assert apply_map(map_, folder / "hyps.npz", folder / name, **{"root_joint": "none", **how}) == 11
    return folder / name


def test_a_spread_map_gives_hypotheses_that_posecal_reads(tmp_path: Path) -> None:
    path = applied(SPREAD, tmp_path)
    poses = read_poses(path, "hypotheses")
    stored, joints, _ = resolve_hypotheses(poses, Declarations(root_joint="none"))
    assert joints == JOINTS
    np.testing.assert_array_equal(stored.read(0, 11), rescaled(X, SPREAD.factors))
    assert stored.read(0, 11).dtype == np.float32
    np.testing.assert_array_equal(poses.frame_id, FRAMES)


@pytest.mark.parametrize("map_", [SPREAD, RADIUS], ids=["spread", "radius"])
def test_files_hold_what_arrays_give(map_: SpreadMap | RadiusMap, tmp_path: Path) -> None:
    with np.load(applied(replace(map_, root=0), tmp_path, root_joint="Hip")) as file:
        if isinstance(map_, SpreadMap):
            np.testing.assert_array_equal(file["hypotheses"].swapaxes(0, 1), map_.apply(X))
        else:
            centre, radius = replace(map_, root=0).apply(X)
            np.testing.assert_array_equal(file["centre"], centre)
            np.testing.assert_array_equal(file["radius"], radius)


def test_a_map_is_applied_to_arrays_of_another_layout_and_unit(tmp_path: Path) -> None:
    words = {"axes": "MNKD", "unit": "m", "joints": JOINTS, "root_joint": "none"}
    assert apply_map(SPREAD, X.swapaxes(0, 1) / 1000, tmp_path / "out.npz", **words) == 11
    with np.load(tmp_path / "out.npz") as file:
        np.testing.assert_allclose(file["hypotheses"].swapaxes(0, 1), rescaled(X, SPREAD.factors), rtol=1e-5, atol=1e-3)


def test_the_root_of_the_hypotheses_keeps_its_place(tmp_path: Path) -> None:
    path = applied(SPREAD, tmp_path, root_joint=None)  # the hip
    with np.load(path) as file:
        np.testing.assert_array_equal(file["hypotheses"].swapaxes(0, 1), rescaled(X, SPREAD.factors, 0))


@pytest.mark.parametrize("scaled", [False, True])
def test_a_radius_map_gives_a_ball_for_every_pose_and_joint(scaled: bool, tmp_path: Path) -> None:
    with np.load(applied(replace(RADIUS, scaled=scaled), tmp_path)) as found:
        x = X.astype("f8")
        np.testing.assert_allclose(found["centre"], np.median(x, axis=0), rtol=1e-5)
        widths = x.std(axis=0, ddof=1).mean(axis=-1) if scaled else np.ones((11, 3))
        np.testing.assert_allclose(found["radius"], RADIUS.radii * widths, rtol=1e-5)
        assert found["alpha"] == 0.1
        assert found["unit"] == "mm"
        assert tuple(found["joints"]) == JOINTS


@pytest.mark.parametrize("map_", [SPREAD, RADIUS], ids=["spread", "radius"])
def test_pieces_give_the_same_file_as_one_piece(
    map_: SpreadMap | RadiusMap, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = applied(map_, tmp_path).read_bytes()
    monkeypatch.setattr(maps, "WINDOW_BYTES", 3 * X[:, 0].nbytes)
    assert applied(map_, tmp_path, name="pieces.npz").read_bytes() == whole


def test_joints_that_the_map_lacks_are_named(tmp_path: Path) -> None:
    with pytest.raises(
        PoseDataError, match=r"^hyps\.npz has joints that the map lacks: LFoot\. Fit a map on these joints"
    ):
        applied(SpreadMap(JOINTS[:2], np.ones(2), 9, 3), tmp_path)
    assert not (tmp_path / "out.npz").exists()


def test_a_file_is_written_whole_or_not_at_all(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(maps, "WINDOW_BYTES", X[:, 0].nbytes)

    def fails(done: int, of: int) -> None:
        assert of == 11
        if done > 4:
            raise KeyboardInterrupt

    (tmp_path / "out.npz").write_bytes(b"before")
    with pytest.raises(KeyboardInterrupt):
        applied(SPREAD, tmp_path, progress=fails)
    assert (tmp_path / "out.npz").read_bytes() == b"before"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["hyps.npz", "out.npz"]


def test_progress_counts_the_poses_that_are_done(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(maps, "WINDOW_BYTES", 4 * X[:, 0].nbytes)
    calls: list[tuple[int, int]] = []
    applied(SPREAD, tmp_path, progress=lambda done, of: calls.append((done, of)))
    assert calls == [(4, 11), (8, 11), (11, 11)]
    monkeypatch.setattr(maps, "WINDOW_BYTES", 1)
    calls.clear()
    applied(SPREAD, tmp_path, progress=lambda done, of: calls.append((done, of)))
    assert calls == [(m, 11) for m in range(1, 12)]


def test_infinite_hypotheses_are_refused_and_not_made_absent(tmp_path: Path) -> None:
    x = X.copy()
    x[0, 3, 0, 0] = np.inf
    with pytest.raises(PoseDataError, match=r"has infinite coordinates .*first: frame 3\); expected numbers, or NaN"):
        applied(SPREAD, tmp_path, x)
    assert not (tmp_path / "out.npz").exists()


@pytest.mark.parametrize("map_", [SPREAD, RADIUS], ids=["spread", "radius"])
@pytest.mark.parametrize(
    ("members", "words"),
    [
        ({"hypotheses": X / 1000}, r"looks like metres: .* unit=\"m\", or store unit in the file; unit=\"mm\" if it"),
        ({"hypotheses": np.concatenate([X, X[..., :1]], -1)}, r"has D = 4 coordinates.*axes=\"NMKC\""),
        ({"hypotheses": np.where(X[2, 7, 1, 0] == X, 1e9, X)}, r"or some beyond 10 km \(1e7 mm\) \(first: frame 7\)"),
        (
            {"hypotheses": np.where(X[2, 7, 1, 0] == X, np.nan, X)},
            r"some hypotheses are absent \(NaN\) \(first: frame 7",
        ),
        (
            {"hypotheses": X, "weights": np.repeat([[0.25], [0.0]], [4, 1], axis=0).repeat(11, axis=1)},
            r"hypotheses are absent \(of weight 0\) in 11 of 11 frames \(first: frame 0\)",
        ),
        ({"hypotheses": X, "frame_id": np.arange(5)}, r"frame_id has 5 values for 11 poses"),
        ({"hypotheses": X, "valid": np.ones((5, 3), dtype=bool)}, r"valid \(5, 3\); expected \(M, K\) = \(11, 3\)"),
    ],
)
def test_files_that_an_evaluation_would_refuse_are_refused(
    map_: SpreadMap | RadiusMap, members: dict[str, Array], words: str, tmp_path: Path
) -> None:
    np.savez(tmp_path / "hyps.npz", joints=JOINTS, axes="NMKD", **members)
    with pytest.raises(PoseDataError, match=rf"^hyps\.npz.* {words}"):
        apply_map(map_, tmp_path / "hyps.npz", tmp_path / "out.npz")
    assert not (tmp_path / "out.npz").exists()


@pytest.mark.parametrize("x", [X, X.swapaxes(0, 1), X[:, :5]], ids=["N < M", "N > M", "N = M"])
def test_axes_that_nothing_tells_are_refused(x: Array, tmp_path: Path) -> None:
    with pytest.raises(
        PoseDataError, match=r"does not tell apart without a truth\. Pass axes=\"NMKD\" or axes=\"MNKD\""
    ):
        apply_map(SPREAD, x, tmp_path / "out.npz", joints=JOINTS, unit="mm")
    assert not (tmp_path / "out.npz").exists()


@pytest.mark.parametrize(
    "members",
    [
        {"hypotheses": X, "axes": "NMKD"},
        {"hypotheses": X / 1000, "unit": "m", "frame_id": np.arange(11)},
        {"hypotheses": np.concatenate([X, X[..., :1]], -1), "axes": "NMKC"},
        {"hypotheses": X.swapaxes(0, 1), "axes": "MNKD"},
        {"hypotheses": np.tile(X, (3, 1, 1, 1)), "frame_id": np.arange(11)},
        {"hypotheses": np.tile(X, (3, 1, 1, 1)), "action": ["walk"] * 11},
    ],
)
def test_what_is_declared_or_told_by_the_frames_is_applied(members: dict[str, Any], tmp_path: Path) -> None:
    np.savez(tmp_path / "hyps.npz", joints=JOINTS, **members)
    assert apply_map(SPREAD, tmp_path / "hyps.npz", tmp_path / "out.npz", root_joint="none") == 11
    with np.load(tmp_path / "out.npz") as file:
        found = file["hypotheses"].swapaxes(0, 1)
    times = len(found) // 5
    np.testing.assert_allclose(found, rescaled(np.tile(X, (times, 1, 1, 1)), SPREAD.factors), rtol=1e-4, atol=0.01)


def test_a_joint_that_no_hypothesis_has_or_that_is_not_valid_may_hold_anything(tmp_path: Path) -> None:
    x, valid = X.copy(), np.ones((11, 3), dtype=bool)
    x[:, 2, 1], x[3, 4, 2], valid[4, 2] = np.nan, 9e9, False
    np.savez(tmp_path / "hyps.npz", hypotheses=x, joints=JOINTS, valid=valid)
    apply_map(SPREAD, tmp_path / "hyps.npz", tmp_path / "out.npz", root_joint="none")
    with np.load(tmp_path / "out.npz") as file:
        found = file["hypotheses"].swapaxes(0, 1)
    assert np.isnan(found[:, 2, 1]).all()
    right = valid.copy()
    right[2, 1] = False
    np.testing.assert_array_equal(found[:, right], rescaled(X, SPREAD.factors)[:, right])


def test_arrays_are_checked_like_files() -> None:
    for map_ in (SPREAD, RADIUS):
        with pytest.raises(PoseDataError, match=r"^hypotheses has D = 4 coordinates"):
            map_.apply(np.concatenate([X, X[..., :1]], -1))
        with pytest.raises(PoseDataError, match=r"^hypotheses has infinite .* beyond 10 km"):
            map_.apply(np.where(X[2, 7, 1, 0] == X, 1e9, X))
        with pytest.raises(PoseDataError, match=r"^hypotheses has joints of which some hypotheses are absent"):
            map_.apply(np.where(X[2, 7, 1, 0] == X, np.nan, X))
    with pytest.raises(
        PoseDataError, match=r"^hypotheses looks like metres: .* unit=\"m\", or unit=\"mm\" if it is right"
    ):
        RADIUS.apply(X / 1000)
    np.testing.assert_allclose(RADIUS.apply(X / 1000, unit="m")[1], RADIUS.apply(X)[1] / 1000)
    np.testing.assert_allclose(
        replace(RADIUS, scaled=True).apply(X / 1000)[1][:, 1:],
        replace(RADIUS, scaled=True).apply(X)[1][:, 1:] / 1000,
        rtol=1e-4,
    )


@pytest.mark.parametrize("map_", [3, None, "map.json"])
def test_what_is_no_map_is_refused(map_: Any, tmp_path: Path) -> None:
    words = r"^map: \w+; expected a SpreadMap or a RadiusMap, as fitting gives\."
    with pytest.raises(PoseDataError, match=words):
        write_map(map_, tmp_path / "map.json")
    with pytest.raises(PoseDataError, match=words):
        apply_map(map_, X, tmp_path / "out.npz")
    assert list(tmp_path.iterdir()) == []
