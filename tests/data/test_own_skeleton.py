"""Skeletons of the user's own: from a file of poses, a small file or a mapping, with clear refusals."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import posecal
from posecal.data.own_skeleton import OwnSkeleton, as_skeleton, checked_parents
from posecal.data.root import Root
from posecal.data.skeleton import JOINT_SETS
from posecal.errors import PoseDataError, PoseFileError

NAMES = ("base", "stem", "leaf 1", "leaf 2")


def arrays(joints: int = 4) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(2)
    truth = rng.normal(0, 300, (7, joints, 3)) + np.array([0, 0, 900])
    return truth + rng.normal(0, 50, (5, 7, joints, 3)), truth


def mpjpe(x: np.ndarray, y: np.ndarray, root: int) -> float:
    return float(np.linalg.norm(x - x[:, :, [root]] - y + y[:, [root]], axis=-1).mean())


def test_parents_in_the_file_of_the_truth_give_bones_and_root(tmp_path: Path) -> None:
    x, y = arrays()
    np.savez(tmp_path / "x.npz", hypotheses=x[:, :, ::-1], unit="mm", joints=NAMES[::-1])
    np.savez(tmp_path / "y.npz", truth=y, unit="mm", joints=NAMES, parents=[1, -1, 1, 1])
    data = posecal.PoseData(tmp_path / "x.npz", tmp_path / "y.npz")
    assert (data.parents, data.root) == ((1, -1, 1, 1), 1)
    report = posecal.evaluate(data)
    assert report["mpjpe"] == pytest.approx(mpjpe(x, y, 1))
    report.save(tmp_path / "r.npz")
    assert posecal.load_totals(tmp_path / "r.npz").spec.parents == (1, -1, 1, 1)


def test_parents_in_a_file_may_be_names(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    y = rng.normal(0, 200, (6, 4, 3))
    for parents in (["stem", "", "stem", "stem"], np.array([b"stem", b"", b"stem", b"stem"])):
        np.savez(tmp_path / "y.npz", truth=y, unit="mm", joints=NAMES, parents=parents)
        data = posecal.PoseData(y[None] + rng.normal(0, 20, (3, 6, 4, 3)), tmp_path / "y.npz", axes="NMKD", unit="mm")
        assert (data.parents, data.root) == ((1, -1, 1, 1), 1)
    np.savez(tmp_path / "y.npz", truth=y, unit="mm", joints=NAMES, parents=["stem", "", "trunk", "stem"])
    with pytest.raises(PoseDataError, match=r"^y\.npz: parent 'trunk' of leaf 1; expected a name, or -1 to 3"):
        posecal.PoseData(y[None] + 1, tmp_path / "y.npz", unit="mm")


def test_parents_of_unnamed_joints_are_taken_too(tmp_path: Path) -> None:
    x, y = arrays()
    np.savez(tmp_path / "y.npz", truth=y, unit="mm", parents=[-1, 0, -1, 2])
    data = posecal.PoseData(x, tmp_path / "y.npz", unit="mm", axes="NMKD")
    assert data.root == Root(((0,), (2,)), (0, 0, 1, 1))


@pytest.mark.parametrize("suffix", ["json", "toml"])
def test_a_small_file_names_joints_parents_and_root(tmp_path: Path, suffix: str) -> None:
    about = {"names": [*NAMES], "parents": ["", "base", "stem", "stem"], "root": "leaf 1+leaf 2"}
    lines = "\n".join(f"{key} = {json.dumps(value)}" for key, value in about.items())
    (tmp_path / f"plant.{suffix}").write_text(json.dumps(about) if suffix == "json" else lines)
    x, y = arrays()
    data = posecal.PoseData(x, y, unit="mm", axes="NMKD", skeleton=tmp_path / f"plant.{suffix}")
    assert (data.joints, data.parents, data.root) == (NAMES, (-1, 0, 1, 1), Root(((2, 3),)))
    report = posecal.evaluate(x, y, unit="mm", axes="NMKD", skeleton=about)
    assert "relative to leaf 1+leaf 2" in str(report)


def test_joints_are_chosen_from_a_larger_skeleton_by_name() -> None:
    skeleton = as_skeleton({"names": NAMES, "parents": [-1, 0, 1, 1], "root": "stem"})
    assert skeleton.of(("Leaf_2", "base")) == OwnSkeleton(("Leaf_2", "base"), (1, -1), "stem")
    with pytest.raises(PoseDataError, match=r"^skeleton: lacks 1 of the poses' joints \(root hair\)"):
        skeleton.of(("base", "root hair"))


def test_a_joint_set_is_a_skeleton() -> None:
    x, y = arrays(21)
    data = posecal.PoseData(x, y, unit="mm", axes="NMKD", skeleton="mano-21")
    assert (data.joints, data.root, data.parents[:3]) == (JOINT_SETS["mano-21"], 0, (-1, 0, 1))


def test_batches_take_a_skeleton_too() -> None:
    x, y = arrays()
    evaluation = posecal.Evaluation(unit="mm", axes="NMKD", skeleton={"names": NAMES, "parents": [-1, 0, 1, 1]})
    evaluation.update(x, y)
    assert evaluation.compute()["mpjpe"] == pytest.approx(mpjpe(x, y, 0))


def test_loose_joints_are_no_roots_of_their_own() -> None:
    x, y = arrays()
    data = posecal.PoseData(x, y, unit="mm", axes="NMKD", skeleton={"names": NAMES, "parents": [-1, 0, 1, -1]})
    assert data.root is None


@pytest.mark.parametrize(
    ("parents", "words"),
    [
        ([-1, 0, 1], r"^s: 3 parents for K = 4 joints; expected one each"),
        (None, r"^s: parents None for K = 4 joints"),
        ([-1, 0, 1, 4], r"^s: parent 4 of leaf 2; expected a name, or -1 to 3: -1 for a root\."),
        ([-2, 0, 1, 1], r"^s: parent -2 of base"),
        ([-1, 0, 1.5, 1], r"^s: parent 1\.5 of leaf 1"),
        ([-1, 0, True, 1], r"^s: parent True of leaf 1"),
        (["", "base", "twig", "stem"], r"^s: parent 'twig' of leaf 1"),
        ([-1, 2, 3, 1], r"^s: parents in a circle \(stem → leaf 1 → leaf 2 → stem\)"),
        ([0, 0, 1, 1], r"^s: parents in a circle \(base → base\)"),
    ],
)
def test_parents_that_can_not_be_are_refused(parents: Any, words: str) -> None:
    with pytest.raises(PoseDataError, match=words):
        checked_parents(parents, "s", NAMES)


@pytest.mark.parametrize(
    ("source", "words"),
    [
        (3, r"^skeleton: int; expected names, parents"),
        ({"names": "base", "parents": [-1]}, r"^skeleton: names 'base'; expected a list"),
        ({"names": ["a", "a"], "parents": [-1, 0]}, r"^skeleton names joints more than once: a"),
        ({"names": ["a"], "parent": [-1]}, r"^skeleton: 'parent' is not known\. Did you mean parents\?"),
        ({"names": ["a"], "parents": [-1], "root": 0}, r"^skeleton: root 0; expected a name, such as a\."),
        ("nowhere.json", r"^nowhere\.json: no such file; expected a skeleton, \.json or \.toml, or one of h36m-17"),
    ],
)
def test_skeletons_that_can_not_be_are_refused(source: object, words: str) -> None:
    with pytest.raises((PoseDataError, PoseFileError), match=words):
        posecal.PoseData(*arrays(), unit="mm", axes="NMKD", skeleton=source)


def test_files_that_are_no_skeletons_are_refused(tmp_path: Path) -> None:
    for text in ("{", "[" * 9000, "[1]"):
        (tmp_path / "s.json").write_text(text)
        with pytest.raises((PoseDataError, PoseFileError), match=r"^s\.json: "):
            as_skeleton(tmp_path / "s.json")
    with pytest.raises(PoseFileError):
        as_skeleton(tmp_path)


def test_parents_of_another_type_are_refused(tmp_path: Path) -> None:
    x, y = arrays()
    np.savez(tmp_path / "y.npz", truth=y, unit="mm", parents=[0.5, 0, 1, 1])
    words = r"^y\.npz: parents: float64 \(4,\); expected \(K,\), numbers \(-1 for a root\) or names\."
    with pytest.raises(PoseDataError, match=words):
        posecal.PoseData(x, tmp_path / "y.npz", unit="mm", axes="NMKD")


def test_pck_follows_the_joint_set_and_names_its_joints() -> None:
    x, y = arrays(24)
    report = posecal.evaluate(x, y, unit="mm", axes="NMKD", joints="smpl-24", metrics="pck,cps")
    assert "the 14 joints (no root), left_hip, right_hip," in report.definition("pck")
    assert "left_foot" not in report.definition("pck")
    for name, number in (("ap-10k", 17), ("mano-21", 21)):
        animal = posecal.evaluate(*arrays(number), unit="mm", axes="NMKD", joints=name, metrics="pck")
        assert f"the {number} joints (root counted)" in animal.definition("pck")


def test_bones_of_what_is_no_person_may_be_short() -> None:
    x, y = arrays(21)
    for options in ({"joints": "mano-21"}, {"skeleton": "h36m-17", "joints": None}):
        k = 21 if options["joints"] else 17
        data = posecal.PoseData(x[:, :, :k] / 15, y[:, :k] / 15, unit="mm", axes="NMKD", **options)  # type: ignore[arg-type]
        assert not any("bone" in remark for remark in data.remarks)
    data = posecal.PoseData(x[:, :, :17] / 15, y[:, :17] / 15, unit="mm", axes="NMKD", joints="h36m-17")
    assert any("the median bone of truth is" in remark for remark in data.remarks)
