"""Do blocks make the whole again, however they are cut, and are numbers refused that are none?"""

from __future__ import annotations

import gc
import weakref

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from posecal.data.arrays import squared_norms
from posecal.data.skeleton import JOINT_SETS
from posecal.engine.block import Block, block_length, iter_blocks, per_pose
from posecal.engine.metric import DataSpec
from posecal.engine.protocol import Protocol
from posecal.errors import PoseDataError
from posecal.metrics import min_mpjpe
from posecal.registry import known_metrics
from tests.helpers.random_worlds import Array, skewed

N, M, K, D = 5, 7, 4, 3


@pytest.fixture
def arrays() -> tuple[Array, Array]:
    return skewed(0, N, M, K, D)


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
    monkeypatch.setattr("posecal.engine.block.BLOCK_BYTES", 1)
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
        patch.setattr("posecal.engine.block.BLOCK_BYTES", length * n * k * d * 8)
        pieces = [lay_out() for lay_out in iter_blocks(x, y, where, follows=follows, scores=scores)]
    assert [len(piece.where) for piece in pieces][:-1] == [max(length, 1)] * (len(pieces) - 1)
    for name in ("offsets", "truth", "where", "scores", "velocity_offsets", "where_before"):
        joined = np.concatenate([getattr(piece, name) for piece in pieces])
        assert joined.tobytes() == np.ascontiguousarray(getattr(whole, name)).tobytes(), name


def test_the_pose_before_may_come_from_an_earlier_read(arrays: tuple[Array, Array]) -> None:
    x, y = arrays
    where = np.random.default_rng(5).random((M, K)) < 0.6
    rest = next(iter_blocks(x[:, 3:], y[3:], where[3:], previous=(x[:, 2:3], y[2:3], where[2:3])))()
    np.testing.assert_allclose(rest.velocity_offsets, Block(x, y, where).velocity_offsets[3:])
    unmasked = next(iter_blocks(x[:, 3:], y[3:], previous=(x[:, 2:3], y[2:3], None)))()
    np.testing.assert_allclose(unmasked.velocity_offsets, Block(x, y).velocity_offsets[3:])


def test_a_statistic_of_every_pose_comes_in_the_order_of_the_poses(
    arrays: tuple[Array, Array], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("posecal.engine.block.BLOCK_BYTES", 2 * N * K * D * 8)
    found = per_pose(lambda block: block.truth[:, 0, 0], *arrays)
    np.testing.assert_allclose(found, arrays[1][:, 0, 0])


def test_squared_norms_are_sums_of_squares() -> None:
    assert squared_norms(np.array([[3.0, 1.0], [4.0, 2.0]])).tolist() == [25.0, 5.0]


def test_a_block_is_let_go_as_soon_as_nobody_holds_it() -> None:
    """Without waiting for the search for circles, or memory would grow with the poses."""
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
