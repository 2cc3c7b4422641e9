"""Alignment by the best map of each family, also where that map is nearly not unique."""

from __future__ import annotations

from typing import get_args

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from posecal.errors import PoseDataError
from posecal.geometry.procrustes import ALIGNMENTS, Alignment, aligned_errors, best_rotations
from posecal.metrics import mpjpe
from tests.helpers import oracles
from tests.helpers.random_worlds import skewed

Array = npt.NDArray[np.floating]
ROTATING = ("similarity", "rigid", "reflection")
PROMISE = 1e-4
"""What is promised against singular value decompositions, in mm, on poses of some 500 mm."""


def errors(x: Array, y: Array, w: npt.NDArray[np.bool_], how: Alignment) -> Array:
    """The module's errors, (N, M, K), from arrays in the paper's layout."""
    weights = w / np.maximum(w.sum(axis=1, keepdims=True), 1)
    return aligned_errors((x - y).transpose(1, 2, 3, 0), y, weights, how).transpose(2, 0, 1)


def random_rotations(random: np.random.Generator, n: int) -> Array:
    """(n, 3, 3)."""
    return Rotation.random(n, random_state=random).as_matrix()


def by_decomposition(F: Array, *, mirrored: bool = False) -> tuple[Array, Array]:
    """The best rotations for (n, 3, 3) matrices and their overlaps, the textbook way."""
    u, sizes, vt = np.linalg.svd(F)
    signs = np.ones(sizes.shape)
    if not mirrored:
        signs[:, 2] = np.sign(np.linalg.det(u @ vt))
    return (u * signs[:, None]) @ vt, (sizes * signs).sum(axis=1)


def found_for(F: Array, *, mirrored: bool = False) -> tuple[Array, Array]:
    """The module's, for the same arguments."""
    rotation, overlap = best_rotations(np.moveaxis(F, 0, -1), mirrored=mirrored)
    return np.moveaxis(rotation, -1, 0), overlap


@pytest.mark.parametrize("how", ALIGNMENTS)
@pytest.mark.parametrize("K", [1, 2, 3, 4, 7])
def test_aligned_errors_are_those_of_one_decomposition_per_pose(how: Alignment, K: int) -> None:
    x, y = skewed(K, N=5, M=11, K=K)
    w = np.ones(y.shape[:2], dtype=bool)
    expected = oracles.joint_errors(oracles.aligned(x, y, w, how), y)
    np.testing.assert_allclose(errors(x, y, w, how), expected, rtol=1e-9, atol=1e-2 * PROMISE)


@pytest.mark.parametrize("how", ALIGNMENTS)
def test_joints_that_do_not_count_do_not_pull(how: Alignment) -> None:
    x, y = skewed(1, N=4, M=13, K=6)
    w = np.random.default_rng(0).random(y.shape[:2]) < 0.6
    w[:, 0] = True
    expected = oracles.joint_errors(oracles.aligned(x, y, w, how), y)
    np.testing.assert_allclose(errors(x, y, w, how)[:, w], expected[:, w], rtol=1e-9, atol=1e-2 * PROMISE)


@pytest.mark.parametrize("how", ALIGNMENTS)
def test_single_precision_stays_within_its_rounding(how: Alignment) -> None:
    x, y = skewed(2, N=5, M=11, K=6)
    w = np.ones(y.shape[:2], dtype=bool)
    single = errors(x.astype("f4"), y.astype("f4"), w.astype("f4"), how)
    assert single.dtype == np.float32
    # Coordinates reach some 1,200 mm; a dozen roundings of 2**-24 each make about 1e-3 mm.
    np.testing.assert_allclose(single, errors(x, y, w, how), atol=12 * 1200 * 2**-24)


@pytest.mark.parametrize("unit", [1e-3, 1e3])
def test_poses_of_another_size_keep_their_precision(unit: float) -> None:
    random = np.random.default_rng(10)
    y = random.normal(0, 300, (11, 6, 3)).astype("f4")
    x = (unit * (np.einsum("mij,mkj->mki", random_rotations(random, 11), y)))[None].astype("f4")
    w = np.ones((11, 6), dtype="f4")
    # The offsets are rounded to 2**-24 of some 1,200 mm or of the larger size, and then scaled.
    np.testing.assert_allclose(errors(x, y, w, "similarity"), 0, atol=4 * 1200 * 2**-24 * max(1, 1 / unit))


@pytest.mark.parametrize(
    ("how", "scale", "mirror", "shift"),
    [
        ("none", 1, 1, 0),
        ("similarity", 1.7, 1, 30),
        ("rigid", 1, 1, 30),
        ("reflection", 0.4, -1, 30),
        ("scale", 0.4, 1, 0),
        ("norm_root", 1.7, 1, 0),
        ("rms_mean", 1.7, 1, 30),
    ],
)
def test_a_pose_moved_by_a_map_of_the_family_is_moved_back(
    how: Alignment, scale: float, mirror: int, shift: float
) -> None:
    random = np.random.default_rng(3)
    y = random.normal(0, 300, (11, 6, 3))
    turn = random_rotations(random, 11) if how in ROTATING else np.broadcast_to(np.eye(3), (11, 3, 3))
    x = scale * np.einsum("mij,mkj->mki", turn, y * [1, 1, mirror]) + shift
    w = np.ones((11, 6), dtype=bool)
    np.testing.assert_allclose(errors(x[None], y, w, how), 0, atol=1e-2 * PROMISE)


def test_rotations_are_those_of_scipy() -> None:
    random = np.random.default_rng(4)
    x, y = random.normal(0, 1, (2, 25, 6, 3))
    found, _ = found_for(np.einsum("mki,mkj->mij", y, x))
    for rotation, points, target in zip(found, x, y, strict=True):
        np.testing.assert_allclose(rotation, Rotation.align_vectors(target, points)[0].as_matrix(), atol=1e-9)


@pytest.mark.parametrize("mirrored", [False, True])
def test_rotations_and_overlaps_are_those_of_the_decomposition(mirrored: bool) -> None:
    F = np.random.default_rng(5).normal(0, 1e4, (300, 3, 3))
    rotation, overlap = found_for(F, mirrored=mirrored)
    expected, size = by_decomposition(F, mirrored=mirrored)
    np.testing.assert_allclose(rotation, expected, atol=1e-7)
    np.testing.assert_allclose(overlap, size, rtol=1e-11)


@pytest.mark.parametrize("tie", [0, *np.logspace(-16, -1, 31)])
@pytest.mark.parametrize("kind", ["two joints", "mirror image"])
def test_near_ties_between_two_best_rotations_stay_rotations_and_stay_best(kind: str, tie: float) -> None:
    """The two best rotations tie where s2 + s3 = 0, with s3 < 0 where F mirrors."""
    random = np.random.default_rng(6)
    n = 200
    if kind == "two joints":  # F of rank one, and nearly so
        s = np.stack([np.ones(n), np.full(n, tie), tie * random.uniform(-1, 1, n)], axis=1)
    else:
        second = random.uniform(0.1, 1, n)
        s = np.stack([np.ones(n), second, -second * (1 - tie)], axis=1)
    F = np.einsum("nij,nj,nkj->nik", random_rotations(random, n), s, random_rotations(random, n))
    rotation, overlap = found_for(F)
    np.testing.assert_allclose(rotation @ rotation.swapaxes(1, 2), np.broadcast_to(np.eye(3), F.shape), atol=1e-7)
    np.testing.assert_allclose(np.linalg.det(rotation), 1, atol=1e-7)
    np.testing.assert_allclose(overlap, by_decomposition(F)[1], atol=1e-9)
    np.testing.assert_allclose((rotation * F).sum(axis=(1, 2)), overlap, atol=1e-9)


def test_no_other_rotation_overlaps_more() -> None:
    random = np.random.default_rng(7)
    F = random.normal(0, 1, (40, 3, 3))
    _, overlap = found_for(F)
    others = random_rotations(random, 500)
    assert (np.einsum("rij,nij->nr", others, F) <= overlap[:, None] + 1e-12).all()


@pytest.mark.parametrize("how", ROTATING)
@pytest.mark.parametrize("shape", ["a point", "a line", "a plane"])
def test_flat_poses_have_finite_errors_no_larger_than_unaligned(how: Alignment, shape: str) -> None:
    random = np.random.default_rng(8)
    rank = ["a point", "a line", "a plane"].index(shape)
    basis = random.normal(0, 1, (3, 3))[:rank]
    y = random.normal(0, 300, (9, 5, rank)) @ basis
    x = random.normal(0, 300, (4, 9, 5, rank)) @ basis
    w = np.ones((9, 5), dtype=bool)
    found = errors(x, y, w, how)
    expected = oracles.joint_errors(oracles.aligned(x, y, w, how), y)
    # On a line, the rotation about it is free: only the squared error, which does not depend on it, is compared.
    np.testing.assert_allclose((found**2).sum(axis=-1), (expected**2).sum(axis=-1), rtol=1e-6, atol=1e-6)
    assert ((found**2).sum(axis=-1) <= (oracles.joint_errors(x, y) ** 2).sum(axis=-1) + 1e-6).all()


def test_on_mirrored_depth_only_a_reflection_helps() -> None:
    y = np.random.default_rng(9).normal(0, 200, (12, 17, 3))
    mirrored = (y * [1, 1, -1])[None]
    np.testing.assert_allclose(mpjpe(mirrored, y, align="reflection"), 0, atol=1e-6)
    assert (mpjpe(mirrored, y, align="similarity") > 20).all()


@given(st.integers(0, 10**6), st.sampled_from(["similarity", "rigid", "reflection"]), st.integers(3, 6))
def test_a_wider_family_never_fits_worse(seed: int, how: Alignment, K: int) -> None:
    x, y = skewed(seed, N=2, M=3, K=K)
    w = np.ones(y.shape[:2], dtype=bool)
    squares = {
        family: (errors(x, y, w, family) ** 2).sum(axis=-1) for family in ("none", "rigid", "similarity", "reflection")
    }
    wider = {"rigid": "none", "similarity": "rigid", "reflection": "similarity"}[how]
    assert (squares[how] <= squares[wider] * (1 + 1e-9) + 1e-6).all()  # type: ignore[index]


def test_an_unknown_family_is_refused_with_the_nearest_one() -> None:
    x, y = skewed(0, N=2, M=3, K=4)
    with pytest.raises(PoseDataError, match=r"align: 'similar' is not known\. Did you mean similarity\?"):
        mpjpe(x, y, align="similar")  # type: ignore[arg-type]


@pytest.mark.parametrize("how", ROTATING)
def test_two_coordinates_cannot_be_rotated(how: Alignment) -> None:
    x, y = skewed(0, N=2, M=3, K=4, D=2)
    with pytest.raises(
        PoseDataError,
        match=r"align: points with 2 coordinates; expected 3 to rotate\. Ask for metrics that don't align",
    ):
        mpjpe(x, y, align=how)


def test_two_coordinates_can_be_scaled() -> None:
    _, y = skewed(0, N=2, M=3, K=4, D=2)
    for how in ("scale", "norm_root", "rms_mean"):
        np.testing.assert_allclose(
            mpjpe(2 * y[None] if how != "rms_mean" else 2 * y[None] + 9, y, align=how), 0, atol=1e-9
        )


def test_the_families_are_those_of_the_type() -> None:
    assert get_args(Alignment) == ALIGNMENTS
