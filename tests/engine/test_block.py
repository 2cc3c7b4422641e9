"""Does a block hold what the formulas ask for?"""

from __future__ import annotations

import math

import numpy as np
import pytest

from posecal.engine.block import Block, iter_blocks
from posecal.errors import PoseDataError
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
    np.testing.assert_allclose(block.weights(), [[third, third, third], [1, 0, 0], [0, 0, 1], [0, 0, 0]])
    only = np.array([True, True, False])
    np.testing.assert_allclose(block.weights(only), [[0.5, 0.5, 0], [1, 0, 0], [0, 0, 0], [0, 0, 0]])


def test_the_whole_of_a_block_holds_the_joints_that_can_be_used_but_do_not_count(arrays: tuple[Array, Array]) -> None:
    x, y = (array.copy() for array in arrays)
    where, usable = np.zeros((M, K), dtype=bool), np.ones((M, K), dtype=bool)
    where[:, 1], usable[2, 0] = True, False
    x[:, 2, 0], y[3, 2] = np.nan, np.inf  # one can't be used, one has no coordinates to use
    usable[3, 2] = True
    block = Block(x, y, where, usable=usable, root=1)
    expected = usable.copy()
    expected[3, 2] = False
    np.testing.assert_array_equal(block.whole.where, expected)
    offsets = oracles.relative(x, 1) - oracles.relative(y, 1)
    np.testing.assert_allclose(block.whole.offsets[expected], offsets.transpose(1, 2, 3, 0)[expected])
    assert not block.offsets[~where].any()
    assert not block.non_finite.any()
    np.testing.assert_allclose(
        block.scale_dispersion(2).whole.offsets[expected], Block(x, y, expected, root=1).stretched(2).offsets[expected]
    )


def test_a_block_of_which_every_usable_joint_counts_is_its_own_whole(arrays: tuple[Array, Array]) -> None:
    block = Block(*arrays, np.random.default_rng(0).random((M, K)) < 0.5)
    assert block.whole is block
    assert block.scale_dispersion(2).whole is not block.whole
    stretched = block.scale_dispersion(2)
    assert stretched.whole is stretched


@pytest.mark.parametrize("root", [None, 1])
def test_the_box_reaches_over_the_true_poses_of_other_sequences_of_which_a_joint_counts(
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


def test_blocks_of_poses_and_what_is_made_of_them_have_the_box_of_all_of_them(
    arrays: tuple[Array, Array], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("posecal.engine.block.BLOCK_BYTES", 1)
    blocks = [lay_out() for lay_out in iter_blocks(*arrays, root=0)]
    assert len(blocks) == M
    for block in blocks:
        np.testing.assert_array_equal(block.scale_dispersion(1.3).range_of_others, block.range_of_others)
    whole = Block(*arrays, root=0).range_of_others
    for end, of_all in enumerate(whole):
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


def test_velocities_start_anew_with_a_sequence_and_where_a_joint_did_not_count(arrays: tuple[Array, Array]) -> None:
    x, y = arrays
    where = np.ones((M, K), dtype=bool)
    where[2, 1] = where[5, 0] = False
    follows = np.array([False, True, True, True, False, True, True])
    block = Block(x, y, where, follows=follows)
    offsets = x - y
    for m, k in np.ndindex(M, K):
        known = follows[m] and where[m, k] and where[m - 1, k]
        step = (offsets[:, m, k] - offsets[:, m - 1, k]).T if known else np.zeros((D, N))
        np.testing.assert_allclose(block.velocity_offsets[m, k], step, atol=1e-11)
        assert block.where_before[m, k] == (follows[m] and where[m - 1, k])


def test_the_first_pose_of_all_has_no_pose_before(arrays: tuple[Array, Array]) -> None:
    assert not Block(*arrays).where_before[0].any()
