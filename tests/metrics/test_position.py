"""Is every member of the MPJPE family what the loops say?"""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from posecal.engine.block import Block
from posecal.errors import PoseDataError
from posecal.geometry.procrustes import ALIGNMENTS, Alignment
from posecal.metrics import min_mpjpe, min_mpjpe_curve, mpjpe
from posecal.metrics.position import OfPoses, joint_errors, linked, pose_errors, pose_of
from tests.helpers import oracles
from tests.helpers.random_worlds import Array, Mask, mostly, skewed

N, M, K = 6, 11, 5
OF_ERRORS = ("min", "mean", "median", "worst")
OF_POSES = ("mean_pose", "median_pose", "mode")


@pytest.fixture
def arrays() -> tuple[Array, Array]:
    return skewed(0, N, M, K)


@pytest.fixture
def where() -> Mask:
    """Some joints that count; in pose 4, none."""
    return mostly(M, K)


def expected(x: Array, y: Array, w: Mask, of: str, align: str, root: int | None, mode: int = 0) -> Array:
    """By the naive formulas."""
    x, y = oracles.relative(x, root), oracles.relative(y, root)
    if of in OF_ERRORS:
        e = oracles.pose_errors(oracles.aligned(x, y, w, align), y, w)
        return np.array([oracles.of_errors(list(column), of) for column in e.T])
    pose = oracles.one_pose(x, of, index=mode)
    return oracles.pose_errors(oracles.aligned(pose, y, w, align), y, w)[0]


@pytest.mark.parametrize("root", [None, 2])
@pytest.mark.parametrize("align", ALIGNMENTS)
@pytest.mark.parametrize("of", [*OF_ERRORS, *OF_POSES])
def test_mpjpe_is_the_naive_formula(
    arrays: tuple[Array, Array], where: Mask, of: OfPoses, align: Alignment, root: int | None
) -> None:
    found = mpjpe(*arrays, of=of, align=align, where=where, root=root, mode=3)
    np.testing.assert_allclose(found, expected(*arrays, where, of, align, root, 3), rtol=1e-9, atol=1e-6)


@given(
    st.integers(1, 5),
    st.integers(1, 6),
    st.integers(1, 4),
    st.integers(1, 4),
    st.integers(0, 10**6),
    st.sampled_from(OF_ERRORS),
)
def test_mpjpe_is_the_naive_formula_for_every_shape(n: int, m: int, k: int, d: int, seed: int, of: OfPoses) -> None:
    x, y = skewed(seed, n, m, k, d)
    w = np.random.default_rng(seed).random((m, k)) < 0.6
    np.testing.assert_allclose(mpjpe(x, y, of=of, where=w), expected(x, y, w, of, "none", None), rtol=1e-12)


@pytest.mark.parametrize("n", [1, 2, 5])
def test_the_median_error_of_an_even_number_lies_between_the_two_in_the_middle(n: int) -> None:
    x, y = skewed(3, n, M, K)
    w = np.ones((M, K), dtype=bool)
    np.testing.assert_allclose(mpjpe(x, y, of="median"), expected(x, y, w, "median", "none", None))


def test_min_mpjpe_is_the_error_of_the_best_hypothesis(arrays: tuple[Array, Array], where: Mask) -> None:
    np.testing.assert_allclose(min_mpjpe(*arrays, where=where), mpjpe(*arrays, of="min", where=where))
    np.testing.assert_allclose(
        min_mpjpe(*arrays, align="rigid", root=1),
        expected(*arrays, np.ones((M, K), bool), "min", "rigid", 1),
        rtol=1e-9,
    )


def test_of_one_hypothesis_every_way_gives_its_error() -> None:
    x, y = skewed(4, 1, M, K)
    errors = oracles.pose_errors(x, y, np.ones((M, K), dtype=bool))[0]
    for of in (*OF_ERRORS, *OF_POSES):
        np.testing.assert_allclose(mpjpe(x, y, of=of), errors, err_msg=of)  # type: ignore[arg-type]


def test_the_root_counts_with_its_error_of_zero() -> None:
    """17 joints over 16: 1.0625."""
    x, y = skewed(5, N, M, 17)
    without = np.ones((M, 17), dtype=bool)
    without[:, 0] = False
    ratio = min_mpjpe(x, y, root=0, where=without) / min_mpjpe(x, y, root=0)
    np.testing.assert_allclose(ratio, 17 / 16)


def test_of_the_field_s_four_best_ofs_each_is_larger_than_the_last() -> None:
    """J-Best < best per frame < best per batch < mean."""
    x, y = skewed(6, 20, 40, 17)
    w = np.ones((40, 17), dtype=bool)
    e, sequence = oracles.pose_errors(x, y, w), [str(m // 10) for m in range(40)]
    j_best = oracles.best_per_joint(x, y, w).mean()
    batch = oracles.best_per_batch(e, sequence, 4)
    assert j_best < min_mpjpe(x, y).mean() < batch < mpjpe(x, y).mean()


def test_a_triangle_of_three_four_five() -> None:
    x = np.zeros((2, 1, 2, 3))
    x[0, 0, 0], x[1, 0, 1] = [3, 4, 0], [0, 0, 1]
    y = np.zeros((1, 2, 3))
    assert [mpjpe(x, y, of=of).entry() for of in ("mean", "min", "worst")] == [1.5, 0.5, 2.5]  # type: ignore[arg-type]


def test_a_pose_without_a_joint_that_counts_has_no_error(arrays: tuple[Array, Array], where: Mask) -> None:
    for of in (*OF_ERRORS, *OF_POSES):
        for align in ALIGNMENTS:
            found = mpjpe(*arrays, of=of, align=align, where=where)  # type: ignore[arg-type]
            assert np.flatnonzero(np.isnan(found)).tolist() == [4]


# --- parts that the registry uses -----------------------------------------------------------------------------------


def test_a_weighted_pose_takes_the_scores_as_weights(arrays: tuple[Array, Array]) -> None:
    x, y = arrays
    scores = np.random.default_rng(2).gamma(1, 1, (N, M))
    found = pose_of(Block(x, y, scores=scores), "weighted_pose")
    assert found.shape == (M, K, 3, 1)
    np.testing.assert_allclose(found[..., 0] + y, oracles.one_pose(x, "weighted_pose", scores)[0])


@pytest.mark.parametrize("scores", [np.linspace(-1, 1, N), np.zeros(N)])
def test_a_weighted_pose_needs_weights(arrays: tuple[Array, Array], scores: Array) -> None:
    block = Block(*arrays, scores=np.tile(scores[:, None], (1, M)))
    with pytest.raises(PoseDataError, match=r"scores below 0, or all 0 for a pose; expected weights"):
        pose_of(block, "weighted_pose")


def test_the_mode_is_the_hypothesis_of_the_highest_score(arrays: tuple[Array, Array]) -> None:
    x, y = arrays
    scores = np.random.default_rng(2).gamma(1, 1, (N, M))
    found = pose_of(Block(x, y, scores=scores), "mode")
    np.testing.assert_allclose(found[..., 0] + y, oracles.one_pose(x, "mode", scores)[0])


def test_the_body_limits_both_the_fit_and_the_mean(arrays: tuple[Array, Array]) -> None:
    x, y = arrays
    body = np.array([True, True, False, True, True])
    block, w = Block(x, y), np.tile(body, (M, 1))
    moved = oracles.aligned(x, y, w, "similarity")
    np.testing.assert_allclose(
        joint_errors(block, "similarity", fit=body).transpose(2, 0, 1), oracles.joint_errors(moved, y), rtol=1e-9
    )
    np.testing.assert_allclose(
        pose_errors(block, "similarity", body=body).T, oracles.pose_errors(moved, y, w), rtol=1e-9
    )


@pytest.mark.parametrize("align", ALIGNMENTS)
@pytest.mark.parametrize("of", [None, *OF_POSES])
def test_joints_that_are_not_scored_take_part_in_the_fit(
    arrays: tuple[Array, Array], where: Mask, align: Alignment, of: OfPoses | None
) -> None:
    """Two occluded joints alone would fit anything."""
    x, y = arrays
    scored, body = where & (np.arange(K) > 2), np.array([True, False, True, True, True])
    block = Block(x, y, scored, usable=where)
    pose = x if of is None else oracles.one_pose(x, of, index=3)
    moved = oracles.aligned(pose, y, where & body, align)
    found = pose_errors(block, align, of, np.arange(K) != 3, 3, fit=body)
    np.testing.assert_allclose(
        found.T, oracles.pose_errors(moved, y, scored & (np.arange(K) != 3)), rtol=1e-9, atol=1e-6
    )


def test_two_fits_do_not_share_a_result(arrays: tuple[Array, Array]) -> None:
    block, body = Block(*arrays), np.arange(K) > 0
    for fit in (np.arange(K) < 4, body, None):
        fresh = pose_errors(Block(*arrays), "similarity", body=body, fit=fit)
        np.testing.assert_array_equal(pose_errors(block, "similarity", body=body, fit=fit), fresh)


def test_two_bodies_do_not_share_a_result(arrays: tuple[Array, Array]) -> None:
    block = Block(*arrays)
    for body in (np.arange(K) < 3, np.arange(K) > 1, None):
        fresh = pose_errors(Block(*arrays), "rigid", body=body)
        np.testing.assert_allclose(pose_errors(block, "rigid", body=body), fresh)


def test_linked_takes_the_values_of_the_hypothesis_that_min_mpjpe_chooses(
    arrays: tuple[Array, Array], where: Mask
) -> None:
    block = Block(*arrays, where)
    values = np.random.default_rng(3).random((M, K, N))
    found = linked(block, values)
    links = oracles.links(oracles.pose_errors(*arrays, where))
    for m in range(M):
        np.testing.assert_allclose(found[m], values[m, :, links[m]])


# --- against n -------------------------------------------------------------------------------------------------------


def test_the_curve_is_the_mean_over_all_subsets(arrays: tuple[Array, Array], where: Mask) -> None:
    sizes = [1, 2, 3, 4, 5, 6]
    found = min_mpjpe_curve(*arrays, sizes, where=where, align="similarity")
    e = oracles.pose_errors(oracles.aligned(*arrays, where, "similarity"), arrays[1], where)
    subsets = [[oracles.best_of_subsets(list(column), n) for n in sizes] for column in e.T]
    np.testing.assert_allclose(found, subsets, rtol=1e-9)


def test_the_curve_goes_from_the_mean_to_the_minimum(arrays: tuple[Array, Array]) -> None:
    found = min_mpjpe_curve(*arrays, np.array([N, 1]), root=0)
    np.testing.assert_allclose(found[:, 1], mpjpe(*arrays, root=0))
    np.testing.assert_allclose(found[:, 0], min_mpjpe(*arrays, root=0))


def test_the_curve_falls() -> None:
    x, y = skewed(7, 300, 4, 3)
    assert (np.diff(min_mpjpe_curve(x, y, np.arange(1, 301))) < 0).all()


@pytest.mark.parametrize("sizes", [[0, 1], [7], [1.5], [], 3, [[1, 2]], [True]])
def test_sizes_that_are_no_numbers_of_hypotheses_are_refused(arrays: tuple[Array, Array], sizes: object) -> None:
    with pytest.raises(PoseDataError, match=r"sizes: .*; expected whole numbers from 1 to N = 6\."):
        min_mpjpe_curve(*arrays, sizes)  # type: ignore[arg-type]


# --- words -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("of", "words"),
    [
        ("medain", r"of: 'medain' is not known\. Did you mean median\?"),
        (
            "weighted_pose",
            r"of: 'weighted_pose' is not known\. Known: min, mean, median, worst, mean_pose, median_pose",
        ),
    ],
)
def test_an_unknown_way_from_many_errors_to_one_is_refused(arrays: tuple[Array, Array], of: str, words: str) -> None:
    with pytest.raises(PoseDataError, match=words):
        mpjpe(*arrays, of=of)  # type: ignore[arg-type]


@pytest.mark.parametrize("mode", [6, -1])
def test_the_mode_s_index_is_one_of_the_hypotheses(arrays: tuple[Array, Array], mode: int) -> None:
    with pytest.raises(PoseDataError, match=rf"mode: {mode}; expected the index of one of 6 hypotheses\."):
        mpjpe(*arrays, of="mode", mode=mode)
