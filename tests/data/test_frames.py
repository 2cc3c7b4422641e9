"""Coordinate frames that differ are named; honest models, however poor, are not suspected."""

from itertools import permutations, product
from typing import Any

import numpy as np
import pytest

import posecal
from posecal.data.frames import DIFFERENT_FRAMES, frame_remark
from posecal.data.pose_data import PoseData
from tests.situations.people import JOINTS, about, people

Array = np.ndarray[Any, Any]
SIDES = [
    JOINTS.index({"L": "R", "R": "L"}[name[0]] + name[1:]) if name[0] in "LR" else k for k, name in enumerate(JOINTS)
]


def remark_of(x: Array, y: Array, **options: Any) -> str:
    given = {"unit": "mm", "joints": JOINTS, "axes": "NMKD", **options}
    return frame_remark(PoseData(x, y, **given))


def model(seed: int = 0, spread: float = 40.0) -> tuple[Array, Array]:
    random = np.random.default_rng(seed)
    truth = people(random, 50)
    return about(random, truth, 10, spread=spread), truth


@pytest.mark.parametrize("signs", [signs for signs in product((1, -1), repeat=3) if min(signs) < 0])
def test_negated_axes_are_named(signs: tuple[int, ...]) -> None:
    x, y = model()
    words = " and ".join(axis for axis, sign in zip("xyz", signs, strict=True) if sign < 0)
    found = remark_of(x * np.array(signs), y)
    # a person seen from behind: x and y negated is a turn by 180°, which is one of the changes too
    assert found.startswith(
        f"{DIFFERENT_FRAMES}: negating {words} in hypotheses turns the error of the mean hypothesis"
    )


@pytest.mark.parametrize("order", [order for order in permutations(range(3)) if order != (0, 1, 2)])
def test_exchanged_axes_are_named_by_what_undoes_them(order: tuple[int, ...]) -> None:
    x, y = model()
    undo = ", ".join("xyz"[axis] for axis in np.argsort(order))
    assert f": taking {undo} for x, y, z in hypotheses turns" in remark_of(x[..., order], y)


def test_exchanged_sides_are_named_in_any_spelling() -> None:
    x, y = model()
    for names in (JOINTS, [name.replace("R", "right_").replace("L", "left_") for name in JOINTS]):
        assert ": exchanging left and right joints in hypotheses turns" in remark_of(x[:, :, SIDES], y, joints=names)
    both = remark_of(x[:, :, SIDES] * [1, 1, -1], y)
    assert ": exchanging left and right joints and negating z in hypotheses turns" in both


@pytest.mark.parametrize("root", ["Hip", "none"])
def test_another_order_of_the_joints_is_named_by_what_undoes_it(root: str) -> None:
    """In names, or where joints are numbered; the root may be among them."""
    x, y = model()
    order = np.roll(np.arange(17), 5)
    undo = [int(np.flatnonzero(order == k)[0]) for k in (0, 1)]
    found = remark_of(x[:, :, order], y, root_joint=root)
    words = ", ".join(f"{JOINTS[j]} for {JOINTS[k]}" for k, j in enumerate(undo))
    assert f": taking {words} and 15 more joints in hypotheses turns" in found
    numbered = remark_of(x[:, :, SIDES], y, joints=None, root_joint="none" if root == "none" else 0)
    assert ": taking joint 4 for joint 1, joint 5 for joint 2 and 10 more joints in hypotheses turns" in numbered


@pytest.mark.parametrize("root", ["Hip", "none"])
def test_one_rotation_of_all_poses_is_named_where_no_axes_are_exchanged(root: str) -> None:
    x, y = model()
    turn = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))[0]
    turn *= np.linalg.det(turn)
    there = y @ turn + [0, 0, 50.0]
    assert ": one rotation of all poses in hypotheses turns" in remark_of(x, there, root_joint=root)


def test_a_factor_and_a_shift_are_named() -> None:
    x, y = model()
    assert ": a factor of 0.098" in remark_of(x * 10, y)
    there = y + np.array([0, 0, 4000.0])
    assert ": a shift of each pose in hypotheses turns" in remark_of(x, there, root_joint="none")
    assert remark_of(x, there) == ""  # relative to the root they agree


def test_joints_that_do_not_count_are_left_out_and_poses_of_few() -> None:
    x, y = model()
    where = np.ones(y.shape[:2], dtype=bool)
    where[np.arange(50), 1 + np.arange(50) % 16] = False
    y[~where] = np.nan
    assert "(50 frames looked at)" in remark_of(x * [1, -1, -1], y, where=where)
    where[:25, 4:] = False
    assert "(25 frames looked at)" in remark_of(x * [1, -1, -1], y, where=where)
    where[:] = False
    assert remark_of(x * [1, -1, -1], y, where=where) == ""


def test_hypotheses_that_are_absent_are_left_out() -> None:
    x, y = model()
    x *= [1, -1, -1]
    padded, scores = x.copy(), np.full(x.shape[:2], 1 / 8)
    padded[2:4], scores[2:4] = 0, 0
    expected = remark_of(np.delete(x, [2, 3], axis=0), y)
    assert expected
    assert remark_of(padded, y, scores=scores) == expected
    padded[2:4] = np.nan
    assert remark_of(padded, y) == expected


@pytest.mark.parametrize("seed", range(12))
def test_a_mirrored_person_is_named_although_some_poses_are_nearly_symmetric(seed: int) -> None:
    x, y = model(seed)
    assert "negating y in hypotheses" in remark_of(x * [1, -1, 1], y)
    augmented = remark_of(x[:, :, SIDES] * [1, -1, 1], y)  # by an augmentation that nothing undid
    assert ": exchanging left and right joints and negating y in hypotheses" in augmented


def test_small_batches_are_looked_at_together() -> None:
    x, y = model()
    parts = [posecal.Evaluation(unit="mm", joints=JOINTS, axes="NMKD") for _ in range(2)]
    for start in range(0, 50, 2):
        rows = slice(start, start + 2)
        parts[start % 4 // 2].update(x[:, rows] * [1, -1, -1], y[rows])
    parts[0].merge(parts[1])
    (remark,) = [r for r in parts[0].totals().remarks if r.startswith(DIFFERENT_FRAMES)]
    assert " frames looked at)" in remark


def test_nothing_is_said_about_calibration_before_frames_agree() -> None:
    x, y = model()
    wrong = posecal.evaluate(x * [1, -1, -1], y, unit="mm", joints=JOINTS, axes="NMKD")
    assert wrong.summary == ()
    assert [remark for remark in wrong.remarks if remark.startswith(DIFFERENT_FRAMES)]
    assert DIFFERENT_FRAMES in str(wrong)
    assert posecal.evaluate(x, y, unit="mm", joints=JOINTS, axes="NMKD").summary
    batches = posecal.Evaluation(unit="mm", joints=JOINTS, axes="NMKD")
    for rows in (slice(0, 20), slice(20, 50)):
        batches.update(x[:, rows] * [1, -1, -1], y[rows])
    assert sum(remark.startswith(DIFFERENT_FRAMES) for remark in batches.compute().remarks) == 1


def test_pixels_have_two_axes() -> None:
    x, y = model()
    flat = (x[..., [0, 2]] * [1, -1], y[..., [0, 2]])
    assert "negating y in hypotheses" in remark_of(*flat, unit="px", root_joint="Hip")


@pytest.mark.slow
def test_honest_models_are_not_suspected() -> None:
    """600 models: sharp or wide, biased, collapsed to the mean pose, turned at random, of another person's pose."""
    alarms: list[int] = []
    for seed in range(600):
        random = np.random.default_rng(seed)
        y = people(random, int(random.integers(2, 80)), jitter=float(random.uniform(20, 120)))
        kind = seed % 6
        x = about(
            random, y, 8, spread=float(10 ** random.uniform(0.5, 2.7)), bias=float(10 ** random.uniform(0.5, 2.5))
        )
        if kind == 1:
            x = x.mean(axis=1, keepdims=True) + 0 * x
        elif kind == 2:
            x = x[:, random.permutation(len(y))]
        elif kind == 3:
            x = people(random, len(y))[None] + random.normal(0, 30, x.shape)
        elif kind == 4:
            x = x * random.uniform(0.6, 1.7)
        elif kind == 5:
            x[..., 1] += random.normal(0, 500, x.shape[:2])[..., None] * (np.arange(17) > 0)
        alarms += [kind] * bool(remark_of(x, y))
    assert len(alarms) <= 6, alarms
