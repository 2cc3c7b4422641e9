"""Blocks: their layout, what they compute for several metrics, and how poses are cut into them."""

from __future__ import annotations

import gc
import math
import platform
import subprocess
import sys
import weakref
from functools import partial

import numpy as np
import pytest

from posecal.data.arrays import squared_norms
from posecal.data.skeleton import JOINT_SETS
from posecal.engine.block import Block
from posecal.engine.per_pose import iter_blocks
from posecal.engine.protocol import Protocol
from posecal.engine.scope import DataSpec
from posecal.errors import PoseDataError
from posecal.registry import known_metrics
from tests.helpers import oracles
from tests.helpers.random_worlds import Array, skewed

N, M, K, D = 5, 7, 4, 3


@pytest.fixture
def arrays() -> tuple[Array, Array]:
    return skewed(0, N, M, K, D)


def test_offsets_are_hypotheses_minus_truth_with_hypotheses_last(arrays: tuple[Array, Array]) -> None:
    x, y = arrays
    block = Block(x, y)
    assert block.offsets.shape == (M, K, D, N)
    for n, m, k, d in np.ndindex(N, M, K, D):
        assert block.offsets[m, k, d, n] == x[n, m, k, d] - y[m, k, d]


@pytest.mark.parametrize("dtype", ["f2", "f4", ">f4", "f8", "g"])
@pytest.mark.parametrize("order", ["NMKD", "MNKD", "KDMN"])
def test_offsets_do_not_depend_on_the_memory_layout(order: str, dtype: str) -> None:
    x, y = (np.round(array).astype(dtype) for array in skewed(3, N, M, K))
    axes = ["NMKD".index(letter) for letter in order]
    turned = np.ascontiguousarray(x.transpose(axes)).transpose(np.argsort(axes))
    found = Block(turned, y).offsets
    assert found.flags.c_contiguous
    assert found.dtype == (np.float64 if dtype in {"f8", "g"} else np.float32)
    np.testing.assert_array_equal(found, (x.astype("f8") - y.astype("f8")).transpose(1, 2, 3, 0))


def test_poses_whose_root_is_right_already_stay_as_they_are(arrays: tuple[Array, Array]) -> None:
    x, y = arrays
    x[:, 3, 2] = y[3, 2]  # in one pose of seven
    expected = oracles.relative(x, 2) - oracles.relative(y, 2)
    np.testing.assert_allclose(Block(x, y, root=2).offsets, expected.transpose(1, 2, 3, 0), atol=1e-12)
    np.testing.assert_array_equal(Block(x, y, root=2).offsets[3], (x[:, 3] - y[3]).transpose(1, 2, 0))


def test_no_joint_is_occluded_unless_it_is_said(arrays: tuple[Array, Array]) -> None:
    occluded = Block(*arrays).occluded
    assert (occluded.shape, occluded.any()) == ((M, K), False)


def test_positions_are_relative_to_the_root(arrays: tuple[Array, Array]) -> None:
    x, y = arrays
    block = Block(x, y, root=2)
    expected = oracles.relative(x, 2) - oracles.relative(y, 2)
    np.testing.assert_allclose(block.offsets, expected.transpose(1, 2, 3, 0), atol=1e-11)
    np.testing.assert_allclose(block.truth, oracles.relative(y, 2))


def test_joints_that_do_not_count_are_zero_whatever_they_hold(arrays: tuple[Array, Array]) -> None:
    x, y = arrays
    where = np.ones((M, K), dtype=bool)
    where[1, 2] = where[3, 0] = where[4, 1] = False
    x[:, 1, 2], y[3, 0] = np.nan, np.inf
    x[:, 4, 1] = y[4, 1] = np.inf
    block = Block(x, y, where)
    assert not block.offsets[~where].any()
    assert not block.truth[~where].any()
    assert not block.non_finite.any()


@pytest.mark.parametrize("n", [1, 2, 5, 6])
def test_the_median_is_numpys(n: int) -> None:
    x, y = skewed(1, n, M, K)
    np.testing.assert_allclose(Block(x, y).median, np.median(x - y, axis=0), atol=1e-12)


@pytest.mark.parametrize("n", [1, 2, 5, 6])
def test_the_variance_is_numpys(n: int) -> None:
    x, y = skewed(1, n, M, K)
    block = Block(x, y)
    np.testing.assert_allclose(block.variance, x.var(axis=0), rtol=1e-10, atol=1e-9)
    np.testing.assert_allclose(block.from_median.transpose(3, 0, 1, 2), x - np.median(x, axis=0), atol=1e-10)


@pytest.mark.parametrize("far", [0.1, 1234.56, 9e4])
def test_the_variance_in_single_precision_does_not_cancel_and_is_0_where_all_agree(far: float) -> None:
    random = np.random.default_rng(2)
    x = (far + random.normal(0, 1 + far / 100, (200, 3, 2, 3))).astype("f4")
    x[:, 1] = x[0, 1]
    x[0, 2] += np.float32(100 * (1 + far))  # far from all others
    found = Block(x, np.zeros((3, 2, 3), dtype="f4")).variance
    assert found.dtype == np.float64
    assert not found[1].any()
    np.testing.assert_allclose(found, x.astype("f8").var(axis=0), rtol=2e-5)


def test_errors_are_distances_from_the_truth(arrays: tuple[Array, Array]) -> None:
    block = Block(*arrays)
    expected = oracles.joint_errors(*arrays).transpose(1, 2, 0)
    np.testing.assert_allclose(block.errors, expected)
    np.testing.assert_allclose(block.squared_errors, expected**2)


def test_sorting_leaves_the_offsets_as_they_are(arrays: tuple[Array, Array]) -> None:
    block = Block(*arrays)
    before = block.offsets.copy()
    np.testing.assert_allclose(block.sorted, np.sort(before, axis=-1))
    np.testing.assert_allclose(block.offsets, before)


def test_weights_share_a_pose_among_the_joints_that_count() -> None:
    where = np.array([[True, True, True], [True, False, False], [False, False, True], [False, False, False]])
    x = np.zeros((2, 4, 3, 3))
    block = Block(x, x[0], where)
    third = 1 / 3
    np.testing.assert_allclose(block.joint_weights(), [[third, third, third], [1, 0, 0], [0, 0, 1], [0, 0, 0]])
    only = np.array([True, True, False])
    np.testing.assert_allclose(block.joint_weights(only), [[0.5, 0.5, 0], [1, 0, 0], [0, 0, 0], [0, 0, 0]])


def test_alignments_are_fitted_to_usable_joints_that_need_not_count(arrays: tuple[Array, Array]) -> None:
    x, y = (array.copy() for array in arrays)
    where, usable = np.zeros((M, K), dtype=bool), np.ones((M, K), dtype=bool)
    where[:, 1], usable[2, 0] = True, False
    x[:, 2, 0], y[3, 2] = np.nan, np.inf  # one can't be used, one has no coordinates to use
    usable[3, 2] = True
    block = Block(x, y, where, usable=usable, root=1)
    expected = usable.copy()
    expected[3, 2] = False
    np.testing.assert_array_equal(block.fit_block.where, expected)
    offsets = oracles.relative(x, 1) - oracles.relative(y, 1)
    np.testing.assert_allclose(block.fit_block.offsets[expected], offsets.transpose(1, 2, 3, 0)[expected])
    assert not block.offsets[~where].any()
    assert not block.non_finite.any()
    np.testing.assert_allclose(
        block.scale_dispersion(2).fit_block.offsets[expected],
        Block(x, y, expected, root=1).scale_dispersion(2).offsets[expected],
    )


def test_alignments_are_fitted_to_the_joints_that_count_where_no_others_are_usable(
    arrays: tuple[Array, Array],
) -> None:
    block = Block(*arrays, np.random.default_rng(0).random((M, K)) < 0.5)
    assert block.fit_block is block
    scaled = block.scale_dispersion(2)
    assert scaled.fit_block is scaled


def test_scaling_the_dispersion_moves_hypotheses_from_their_median(arrays: tuple[Array, Array]) -> None:
    x, y = arrays
    block = Block(x, y, scores=np.ones((N, M)), occluded=np.ones((M, K), dtype=bool))
    assert block.errors.any()
    assert block.variance.all()
    scaled = block.scale_dispersion(1.5)
    centre = np.median(x, axis=0)
    np.testing.assert_allclose(scaled.offsets, Block(centre + 1.5 * (x - centre), y).offsets, atol=1e-10)
    np.testing.assert_allclose(scaled.sorted, np.sort(scaled.offsets, axis=-1))
    np.testing.assert_allclose(scaled.errors, np.linalg.norm(scaled.offsets, axis=2))
    np.testing.assert_allclose(scaled.variance, 1.5**2 * block.variance)
    assert scaled.where is block.where
    assert scaled.occluded is block.occluded
    np.testing.assert_array_equal(scaled.scores, block.scores)


@pytest.mark.parametrize("root", [None, 1])
def test_the_range_is_that_of_the_true_poses_of_other_sequences_of_which_a_joint_counts(
    arrays: tuple[Array, Array], root: int | None
) -> None:
    y = arrays[1].copy()
    where = np.ones((M, K), dtype=bool)
    where[0, 2] = where[4:, 2] = where[:, 3] = False
    y[0, 2], y[5, 3] = np.nan, np.inf
    relative = y if root is None else oracles.relative(y, root)
    sequence = np.arange(M) % 3 * 5 + 2  # by any numbers
    for own in (sequence, np.arange(M)):
        found = Block(arrays[0], y, where, root=root, sequence=own).range_of_others
        for m, k, d in np.ndindex(M, K, D):
            others = (own != own[m]) & where[:, k] & np.isfinite(relative[:, k, d])
            column = relative[others, k, d]
            expected = column.min(initial=math.inf), column.max(initial=-math.inf)
            np.testing.assert_allclose([ends[m, k, d] for ends in found], expected)


def test_blocks_of_poses_and_what_is_made_of_them_have_the_range_of_all_of_them(
    arrays: tuple[Array, Array], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("posecal.engine.block.BLOCK_BYTES", 1)
    blocks = [lay_out() for lay_out in iter_blocks(*arrays, root=0)]
    assert len(blocks) == M
    for block in blocks:
        np.testing.assert_array_equal(block.scale_dispersion(1.3).range_of_others, block.range_of_others)
    for end, of_all in enumerate(Block(*arrays, root=0).range_of_others):
        np.testing.assert_array_equal([block.range_of_others[end][0] for block in blocks], of_all)


def test_what_is_shared_is_computed_once(arrays: tuple[Array, Array]) -> None:
    block, calls = Block(*arrays), []
    for _ in range(2):
        assert block.share("key", lambda: calls.append(1) or 7) == 7
    assert block.share("other key", lambda: 8) == 8
    assert len(calls) == 1


def test_scores_that_were_not_given_are_asked_for(arrays: tuple[Array, Array]) -> None:
    with pytest.raises(PoseDataError, match=r"hypotheses: no scores given; expected a member scores \(N, M\)"):
        _ = Block(*arrays).scores


@pytest.mark.parametrize("score", [np.nan, np.inf])
def test_scores_that_are_not_finite_are_refused(arrays: tuple[Array, Array], score: float) -> None:
    scores = np.ones((N, M))
    scores[2, 3] = score
    with pytest.raises(PoseDataError, match=r"hypotheses: scores that are not finite; expected a number for each"):
        _ = Block(*arrays, scores=scores).scores


def test_scores_stand_by_pose_and_hypothesis(arrays: tuple[Array, Array]) -> None:
    scores = np.arange(N * M).reshape(N, M)
    assert Block(*arrays, scores=scores).scores[3, 2] == scores[2, 3]


COEFFICIENTS = {1: [1, -1], 2: [1, -2, 1], 3: [1, -3, 3, -1]}


@pytest.mark.parametrize("order", COEFFICIENTS)
def test_differences_start_anew_with_a_sequence_and_where_a_joint_did_not_count(
    arrays: tuple[Array, Array], order: int
) -> None:
    x, y = arrays
    where = np.ones((M, K), dtype=bool)
    where[2, 1] = where[5, 0] = False
    follows = np.array([False, True, True, True, False, True, True])
    block = Block(x, y, where, follows=follows)
    (offsets, counted), (truth, _) = block.differences(order, "offsets"), block.differences(order, "truth")
    for m, k in np.ndindex(M, K):
        poses = [m - back for back in range(order + 1)]
        known = min(poses) >= 0 and follows[poses[:-1]].all() and where[poses, k].all()
        assert counted[m, k] == known
        expected = np.tensordot(COEFFICIENTS[order], (x - y)[:, poses, k], (0, 1)).T if known else np.zeros((D, N))
        np.testing.assert_allclose(offsets[m, k], expected, atol=1e-10)
        expected = np.tensordot(COEFFICIENTS[order], y[poses, k], 1) if known else np.zeros(D)
        np.testing.assert_allclose(truth[m, k], expected, atol=1e-10)


@pytest.mark.parametrize("order", COEFFICIENTS)
def test_the_first_poses_of_all_have_none_before(arrays: tuple[Array, Array], order: int) -> None:
    counted = Block(*arrays).differences(order, "offsets")[1]
    assert not counted[:order].any()
    assert counted[order:].all()


@pytest.mark.parametrize("order", COEFFICIENTS)
@pytest.mark.parametrize("earlier", [1, 2, 3])
def test_the_poses_before_may_come_from_an_earlier_read(arrays: tuple[Array, Array], order: int, earlier: int) -> None:
    x, y = arrays
    where = np.random.default_rng(5).random((M, K)) < 0.8
    before = partial(Block, x[:, 4 - earlier : 4], y[4 - earlier : 4], where[4 - earlier : 4])
    rest = Block(x[:, 4:], y[4:], where[4:], previous=before).differences(order, "offsets")
    own = Block(x[:, 4 - earlier :], y[4 - earlier :], where[4 - earlier :]).differences(order, "offsets")
    for found, expected in zip(rest, own, strict=True):
        np.testing.assert_array_equal(found, expected[earlier:])


def test_a_block_is_freed_as_soon_as_nobody_holds_it() -> None:
    """Without waiting for the search for reference cycles, or memory would grow with the poses."""
    x, y = np.random.default_rng(0).normal(0, 300, (2, 5, 4, 17, 3))
    gc.disable()
    try:
        (lay_out,) = iter_blocks(x, y[0])
        block = lay_out()
        for metric in known_metrics(Protocol(), DataSpec(5, JOINT_SETS["h36m-17"], root=0)).values():
            metric.statistic.compute(block)
        gone = weakref.ref(block)
        del block, lay_out
        assert gone() is None
    finally:
        gc.enable()


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="about glibc's allocator")
def test_the_memory_of_freed_blocks_is_used_again() -> None:
    walks = """
import resource, numpy as np
from posecal.metrics import mpjpe
x = np.zeros((50, 1000, 17, 3), dtype="f4")
def pages():
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    mpjpe(x, x[0], align="similarity")
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before
pages()
print(pages() * resource.getpagesize() / x.nbytes)
"""
    run = subprocess.run([sys.executable, "-c", walks], capture_output=True, text=True, check=True)
    assert float(run.stdout) < 0.5  # 10 where every block's arrays are new


def test_squared_norms_are_sums_of_squares() -> None:
    assert squared_norms(np.array([[3.0, 1.0], [4.0, 2.0]])).tolist() == [25.0, 5.0]
