"""Maps are written and read as JSON, broken files are refused, and maps are applied to files of hypotheses."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from posecal.data.declarations import Declarations
from posecal.data.match import resolve_hypotheses
from posecal.data.read import read_poses
from posecal.errors import PoseDataError, PoseFileError
from posecal.recalibration import RadiusMap, SpreadMap, apply_map, maps, read_map, write_map
from posecal.recalibration.dispersion import rescaled
from tests.helpers.random_worlds import skewed

Array = np.ndarray
JOINTS = ("Hip", "Head", "LFoot")
SPREAD = SpreadMap(JOINTS, np.array([1.0, 0.7, 2.125]), 120, 6, 0)
RADIUS = RadiusMap(JOINTS, np.array([math.nan, 80.5, 120.25]), 0.1, False, 120, 6)


@pytest.mark.parametrize("map_", [SPREAD, RADIUS, replace(RADIUS, scaled=True)], ids=["spread", "mm", "deviations"])
def test_a_map_that_is_written_is_read_as_it_was(map_: SpreadMap | RadiusMap, tmp_path: Path) -> None:
    write_map(map_, tmp_path / "map.json")
    found = read_map(tmp_path / "map.json")
    assert type(found) is type(map_)
    for name, value in vars(map_).items():
        np.testing.assert_array_equal(getattr(found, name), value)


def test_a_person_can_read_it(tmp_path: Path) -> None:
    write_map(RADIUS, tmp_path / "map.json")
    found = json.loads((tmp_path / "map.json").read_text())
    assert found["kind"] == "radius"
    assert found["format"] == 2
    assert found["radii"] == {"Hip": None, "Head": 80.5, "LFoot": 120.25}
    assert (found["alpha"], found["unit"]) == (0.1, "mm")
    assert found["fitted_on"] == {"poses": 120, "sequences": 6}
    assert found["root"] is None
    write_map(SPREAD, tmp_path / "map.json")
    found = json.loads((tmp_path / "map.json").read_text())
    assert (found["factors"], found["root"]) == ({"Hip": 1.0, "Head": 0.7, "LFoot": 2.125}, "Hip")


def broken(kind: str, /, **changed: Any) -> str:
    """A map of which something is otherwise."""
    about: dict[str, Any] = {"format": 2, "kind": kind, "root": None, "fitted_on": {"poses": 9, "sequences": 3}}
    if kind == "radius":
        about |= {"alpha": 0.1, "unit": "mm", "radii": {"Head": 80.0}}
    else:
        about |= {"factors": {"Head": 1.5}}
    about |= changed
    return json.dumps({key: value for key, value in about.items() if value is not ...})


NO_MAP = r"map\.json: no map of posecal recalibrate fit, or not a whole one"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", NO_MAP),
        ("{", NO_MAP),
        ("[]", NO_MAP),
        ("3", NO_MAP),
        (broken("spread")[:40], NO_MAP),
        (broken("spread", format=1), r"map\.json: format 1; expected 2\. Fit it again"),
        (broken("spread", format=...), NO_MAP),
        (broken("spread", kind=...), NO_MAP),
        (broken("radius", kind="square"), NO_MAP),
        (broken("spread", factors=...), NO_MAP),
        (broken("spread", factors=[1.5]), NO_MAP),
        (broken("spread", factors={"Head": "wide"}), NO_MAP),
        (broken("spread", factors={"Head": 0}), r"a factor is not above 0"),
        (broken("spread", factors={"Head": -1.5}), r"a factor is not above 0"),
        (broken("spread", factors={"Head": None}), r"a factor is not above 0"),
        (broken("spread", factors={"Head": math.inf}), r"a factor is not above 0"),
        (broken("spread", fitted_on=...), NO_MAP),
        (broken("spread", root=...), NO_MAP),
        (broken("spread", root="Tail"), NO_MAP),
        (broken("radius", radii=...), NO_MAP),
        (broken("radius", radii={"Head": -1}), r"a radius is below 0 or alpha is 0\.1"),
        (broken("radius", radii={"Head": math.inf}), r"a radius is below 0"),
        (broken("radius", unit="cm"), NO_MAP),
        (broken("radius", alpha=7), r"alpha is 7; expected 0 < alpha < 1"),
        (broken("radius", alpha=...), NO_MAP),
    ],
)
def test_a_file_that_is_no_complete_map_is_refused(text: str, words: str, tmp_path: Path) -> None:
    (tmp_path / "map.json").write_text(text)
    with pytest.raises(PoseFileError, match=words):
        read_map(tmp_path / "map.json")


def test_a_file_that_can_not_be_read_is_refused(tmp_path: Path) -> None:
    with pytest.raises(PoseFileError, match=r"none\.json: no such file"):
        read_map(tmp_path / "none.json")
    with pytest.raises(PoseFileError, match=r"can't be read \(Is a directory\)"):
        read_map(tmp_path)
    (tmp_path / "map.json").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(PoseFileError, match=NO_MAP):
        read_map(tmp_path / "map.json")


# --- applying them ----------------------------------------------------------------------------------------------------

X = skewed(1, 5, 11, 3)[0].astype("f4")


def applied(map_: SpreadMap | RadiusMap, folder: Path, x: Array = X, name: str = "out.npz") -> Path:
    """Apply to hypotheses in a file."""
    np.savez(folder / "hyps.npz", hypotheses=x, axes="NMKD", unit="mm", joints=JOINTS)
    stored, joints, root = resolve_hypotheses(
        read_poses(folder / "hyps.npz", "hypotheses"), Declarations(root_joint="none")
    )
    frames = {"frame_id": np.array([f"f{m}" for m in range(x.shape[1])])}
    apply_map(map_, stored, joints, root, x.shape[1], folder / name, frames)
    return folder / name


def test_a_spread_map_gives_hypotheses_that_posecal_reads(tmp_path: Path) -> None:
    path = applied(SPREAD, tmp_path)
    poses = read_poses(path, "hypotheses")
    stored, joints, _ = resolve_hypotheses(poses, Declarations(root_joint="none"))
    assert joints == JOINTS
    np.testing.assert_array_equal(stored.read(0, 11), rescaled(X, SPREAD.factors))
    assert stored.read(0, 11).dtype == np.float32
    np.testing.assert_array_equal(poses.frame_id, [f"f{m}" for m in range(11)])


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
def test_pieces_give_the_same_file_as_the_whole(
    map_: SpreadMap | RadiusMap, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = applied(map_, tmp_path).read_bytes()
    monkeypatch.setattr(maps, "WINDOW_BYTES", 3 * X[:, 0].nbytes)
    assert applied(map_, tmp_path, name="pieces.npz").read_bytes() == whole


def test_joints_that_the_map_lacks_are_named(tmp_path: Path) -> None:
    with pytest.raises(
        PoseDataError, match=r"hypotheses has joints that the map lacks: LFoot\. Fit a map on these joints"
    ):
        applied(SpreadMap(JOINTS[:2], np.ones(2), 9, 3), tmp_path)
    assert not (tmp_path / "out.npz").exists()


def test_a_file_is_written_whole_or_not_at_all(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(maps, "WINDOW_BYTES", X[:, 0].nbytes)

    def fails(done: int) -> None:
        if done > 4:
            raise KeyboardInterrupt

    (tmp_path / "out.npz").write_bytes(b"before")
    np.savez(tmp_path / "hyps.npz", hypotheses=X, axes="NMKD", unit="mm", joints=JOINTS)
    stored, joints, root = resolve_hypotheses(
        read_poses(tmp_path / "hyps.npz", "hypotheses"), Declarations(root_joint="none")
    )
    with pytest.raises(KeyboardInterrupt):
        apply_map(SPREAD, stored, joints, root, 11, tmp_path / "out.npz", {}, fails)
    assert (tmp_path / "out.npz").read_bytes() == b"before"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["hyps.npz", "out.npz"]
