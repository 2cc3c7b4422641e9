"""Do blocks hold what the formulas ask for, however the arrays lie in memory and however they are cut?"""

from __future__ import annotations

import gc
import math
import re
import weakref
from collections.abc import Iterator

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st

from posecal.arrays import checked, squared_norms, working_dtype
from posecal.block import Block
from posecal.blocks import block_length, blocks_of, per_pose
from posecal.errors import PoseDataError
from posecal.metric import Subject
from posecal.metrics import min_mpjpe
from posecal.protocol import Protocol
from posecal.registry import known_metrics
from posecal.skeleton import JOINT_SETS
from tests import oracles
from tests.drawn import skewed

Array = npt.NDArray[np.floating]

N, M, K, D = 5, 7, 4, 3


@pytest.fixture
def arrays() -> tuple[Array, Array]:
    return skewed(0, N, M, K, D)


# --- one block ----------------------------------------------------------------------------------------------------


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
        block.stretched(2).whole.offsets[expected], Block(x, y, expected, root=1).stretched(2).offsets[expected]
    )


def test_a_block_of_which_every_usable_joint_counts_is_its_own_whole(arrays: tuple[Array, Array]) -> None:
    block = Block(*arrays, np.random.default_rng(0).random((M, K)) < 0.5)
    assert block.whole is block
    assert block.stretched(2).whole is not block.whole
    stretched = block.stretched(2)
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
        found = Block(arrays[0], y, where, root=root, sequence=own).box_of_others
        for m, k, d in np.ndindex(M, K, D):
            others = (own != own[m]) & where[:, k] & np.isfinite(relative[:, k, d])
            column = relative[others, k, d]
            expected = column.min(initial=math.inf), column.max(initial=-math.inf)
            np.testing.assert_allclose([ends[m, k, d] for ends in found], expected)


def test_blocks_of_poses_and_what_is_made_of_them_have_the_box_of_all_of_them(
    arrays: tuple[Array, Array], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("posecal.blocks.BLOCK_BYTES", 1)
    blocks = [lay_out() for lay_out in blocks_of(*arrays, root=0)]
    assert len(blocks) == M
    for block in blocks:
        np.testing.assert_array_equal(block.stretched(1.3).box_of_others, block.box_of_others)
    whole = Block(*arrays, root=0).box_of_others
    for end, of_all in enumerate(whole):
        np.testing.assert_array_equal([block.box_of_others[end][0] for block in blocks], of_all)


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


# --- what is not a number -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("root", [None, 0])
def test_a_coordinate_that_is_not_finite_is_refused_with_its_place(value: float, root: int | None) -> None:
    x, y = skewed(2, N, 40, K)
    x[3, 33, 2, 1] = value
    with pytest.raises(PoseDataError, match=r"non-finite coordinates \(first: pose 33, joint 2\)\. Mask those joints"):
        min_mpjpe(x, y, root=root)


def test_the_place_does_not_depend_on_the_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    x, y = skewed(2, N, 40, K)
    y[33, 2, 1] = np.nan
    monkeypatch.setattr("posecal.blocks.BLOCK_BYTES", 1)
    with pytest.raises(PoseDataError, match="pose 33, joint 2"):
        min_mpjpe(x, y)


def test_a_root_that_is_not_finite_is_refused() -> None:
    x, y = skewed(2, N, M, K)
    x[0, 5, 1] = np.inf
    with pytest.raises(PoseDataError, match=r"non-finite coordinates \(first: pose 5"):
        min_mpjpe(x, y, root=1)


def test_large_numbers_whose_squares_overflow_are_not_called_infinite() -> None:
    x, y = np.full((1, 1, 1, 3), 1e25, dtype="f4"), np.zeros((1, 1, 3), dtype="f4")
    with np.errstate(over="ignore"):
        assert not Block(x, y).non_finite.any()


# --- what comes in -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("hypotheses", "truth", "words"),
    [
        (
            (5, 17, 3),
            (7, 5, 17, 3),
            "hypotheses (5, 17, 3) and truth (7, 5, 17, 3): expected (N, M, K, D) and (M, K, D). The two look swapped.",
        ),
        ((5, 17, 3), (17, 3), "hypotheses (5, 17, 3) and truth (17, 3): expected (N, M, K, D) and (M, K, D)."),
        ((2, 5, 4, 3), (6, 4, 3), "but M is 5 and 6."),
        ((2, 5, 4, 3), (6, 9, 2), "but M is 5 and 6, K is 4 and 9, D is 3 and 2."),
        (
            (0, 5, 4, 3),
            (5, 4, 3),
            "hypotheses (0, 5, 4, 3) and truth (5, 4, 3): N is 0; expected at least one of each.",
        ),
        ((2, 0, 4, 0), (0, 4, 0), "M, D is 0; expected at least one of each."),
    ],
)
def test_shapes_that_do_not_fit_are_named_by_their_letters(
    hypotheses: tuple[int, ...], truth: tuple[int, ...], words: str
) -> None:
    with pytest.raises(PoseDataError, match=re.escape(words)):
        checked(np.zeros(hypotheses), np.zeros(truth))


@pytest.mark.parametrize("dtype", ["bool", "complex128", "U3", "O"])
def test_what_are_no_real_numbers_is_refused(dtype: str) -> None:
    good, bad = np.zeros((2, 3, 4, 3)), np.zeros((3, 4, 3)).astype(dtype)
    with pytest.raises(PoseDataError, match=r"truth: dtype .*; expected real numbers such as float32"):
        checked(good, bad)


@pytest.mark.parametrize(
    ("where", "found"),
    [
        (np.ones((3, 4)), r"float64 \(3, 4\)"),
        (np.ones((4, 3), dtype=bool), r"bool \(4, 3\)"),
        ([1, 0], r"int64 \(2,\)"),
    ],
)
def test_a_mask_of_another_type_or_shape_is_refused(where: npt.ArrayLike, found: str) -> None:
    with pytest.raises(PoseDataError, match=rf"where: {found}; expected bool \(M, K\) = \(3, 4\)"):
        checked(np.zeros((2, 3, 4, 3)), np.zeros((3, 4, 3)), where)


@pytest.mark.parametrize("root", [4, -5, 99])
def test_a_root_beyond_the_joints_is_refused(root: int, arrays: tuple[Array, Array]) -> None:
    with pytest.raises(PoseDataError, match=rf"root: {root}; expected the index of one of 4 joints"):
        min_mpjpe(*arrays, root=root)


def test_a_root_may_be_counted_from_the_end(arrays: tuple[Array, Array]) -> None:
    np.testing.assert_allclose(min_mpjpe(*arrays, root=-1), min_mpjpe(*arrays, root=K - 1))


@pytest.mark.parametrize(
    ("dtype", "working"),
    [("f2", "f4"), ("f4", "f4"), (">f4", "f4"), ("f8", "f8"), ("g", "f8"), ("i2", "f8"), ("u1", "f8")],
)
def test_single_precision_stays_single_and_all_else_is_double(dtype: str, working: str) -> None:
    assert working_dtype(dtype) == np.dtype(working)


@pytest.mark.parametrize("dtype", ["f2", "f4", ">f4", ">f8", "g", "i2", "i8"])
@pytest.mark.parametrize("root", [None, 1])
@pytest.mark.parametrize("align", ["none", "similarity", "scale"])
def test_every_type_of_number_gives_what_double_gives(dtype: str, root: int | None, align: str) -> None:
    x, y = (array.astype(dtype) for array in skewed(3, N, M, K))
    expected = min_mpjpe(x.astype("f8"), y.astype("f8"), root=root, align=align)  # type: ignore[arg-type]
    found = min_mpjpe(x, y, root=root, align=align)  # type: ignore[arg-type]
    assert found.dtype == np.float64
    # Coordinates reach 1,200 mm; in single precision a dozen roundings make about 1e-3 mm.
    np.testing.assert_allclose(found, expected, atol=12 * 1200 * 2.0 ** -(24 if dtype[-2:] in {"f2", "f4"} else 49))


def test_lists_are_taken_as_arrays() -> None:
    assert min_mpjpe([[[[3, 4, 0]]]], [[[0, 0, 0]]]).tolist() == [5.0]


def layouts(x: Array) -> Iterator[Array]:
    """The same numbers, in memory in other ways."""
    yield np.asfortranarray(x)
    yield x[::-1].copy()[::-1]
    yield np.repeat(x, 2, axis=-2)[..., ::2, :]
    yield np.flip(np.flip(x, -1).copy(), -1)
    yield np.moveaxis(np.ascontiguousarray(np.moveaxis(x, 0, -1)), -1, 0)


def test_numbers_do_not_depend_on_the_layout_in_memory(arrays: tuple[Array, Array]) -> None:
    expected = min_mpjpe(*arrays)
    for x, y in zip(layouts(arrays[0]), layouts(arrays[1]), strict=True):
        assert min_mpjpe(x, y).tobytes() == expected.tobytes()


def test_arrays_stay_as_they_were_and_may_be_read_only(arrays: tuple[Array, Array]) -> None:
    x, y, where = *arrays, np.random.default_rng(0).random((M, K)) < 0.7
    before = [array.tobytes() for array in (x, y, where)]
    for array in (x, y, where):
        array.flags.writeable = False
    min_mpjpe(x, y, where=where, root=0, align="similarity")
    assert [array.tobytes() for array in (x, y, where)] == before


# --- cutting -----------------------------------------------------------------------------------------------------


def test_a_block_holds_about_as_many_bytes_as_it_should() -> None:
    assert block_length((200, 9999, 16, 3), "f4") == 1024 * 1024 // (200 * 16 * 3 * 4)
    assert block_length((200, 9999, 16, 3), "f8") == 1024 * 1024 // (200 * 16 * 3 * 8)


def test_a_block_has_at_least_one_pose_and_at_most_512() -> None:
    assert block_length((10**6, 5, 17, 3), "f8") == 1
    assert block_length((1, 10**6, 1, 1), "f4") == 512


@given(
    st.integers(1, 9), st.integers(1, 4), st.integers(1, 5), st.integers(1, 3), st.integers(0, 6), st.integers(0, 10**6)
)
def test_pieces_of_every_length_make_the_whole(m: int, n: int, k: int, d: int, length: int, seed: int) -> None:
    x, y = skewed(seed, n, m, k, d)
    random = np.random.default_rng(seed)
    where, follows, scores = random.random((m, k)) < 0.7, random.random(m) < 0.7, random.random((n, m))
    whole = Block(x, y, where, follows=follows, scores=scores)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("posecal.blocks.BLOCK_BYTES", length * n * k * d * 8)
        pieces = [lay_out() for lay_out in blocks_of(x, y, where, follows=follows, scores=scores)]
    assert [len(piece.where) for piece in pieces][:-1] == [max(length, 1)] * (len(pieces) - 1)
    for name in ("offsets", "truth", "where", "scores", "velocity_offsets", "where_before"):
        joined = np.concatenate([getattr(piece, name) for piece in pieces])
        assert joined.tobytes() == np.ascontiguousarray(getattr(whole, name)).tobytes(), name


def test_the_pose_before_may_come_from_an_earlier_read(arrays: tuple[Array, Array]) -> None:
    x, y = arrays
    where = np.random.default_rng(5).random((M, K)) < 0.6
    rest = next(blocks_of(x[:, 3:], y[3:], where[3:], previous=(x[:, 2:3], y[2:3], where[2:3])))()
    np.testing.assert_allclose(rest.velocity_offsets, Block(x, y, where).velocity_offsets[3:])
    unmasked = next(blocks_of(x[:, 3:], y[3:], previous=(x[:, 2:3], y[2:3], None)))()
    np.testing.assert_allclose(unmasked.velocity_offsets, Block(x, y).velocity_offsets[3:])


def test_a_statistic_of_every_pose_comes_in_the_order_of_the_poses(
    arrays: tuple[Array, Array], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("posecal.blocks.BLOCK_BYTES", 2 * N * K * D * 8)
    found = per_pose(lambda block: block.truth[:, 0, 0], *arrays)
    np.testing.assert_allclose(found, arrays[1][:, 0, 0])


def test_squared_norms_are_sums_of_squares() -> None:
    assert squared_norms(np.array([[3.0, 1.0], [4.0, 2.0]])).tolist() == [25.0, 5.0]


def test_a_block_is_let_go_as_soon_as_nobody_holds_it() -> None:
    """Without waiting for the search for circles, or memory would grow with the poses."""
    x, y = np.random.default_rng(0).normal(0, 300, (2, 5, 4, 17, 3))
    gc.disable()
    try:
        (lay_out,) = blocks_of(x, y[0])
        block = lay_out()
        for metric in known_metrics(Protocol(), Subject(5, JOINT_SETS["h36m-17"], root=0)).values():
            metric.statistic.compute(block)
        gone = weakref.ref(block)
        del block, lay_out
        assert gone() is None
    finally:
        gc.enable()
