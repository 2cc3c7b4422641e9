"""Blocks of two arrays, and statistics of every pose: their places, and coordinates that are not finite."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st

from posecal.engine.block import BLOCK_BYTES, MOST_POSES, Block, block_length
from posecal.engine.per_pose import iter_blocks, per_pose
from posecal.errors import PoseDataError
from posecal.metrics import min_mpjpe, mpjpe
from tests.helpers.random_worlds import Array, skewed

N, M, K, D = 5, 7, 4, 3


@pytest.fixture
def arrays() -> tuple[Array, Array]:
    return skewed(0, N, M, K, D)


# --- what is not a number -----------------------------------------------------------------------------------------


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


@pytest.mark.parametrize("root", ["0", 1.0, K, -K - 1, True, [0]])
def test_a_root_that_is_no_joint_is_refused(root: object) -> None:
    with pytest.raises(PoseDataError, match=r"root: .*; expected the index of one of 4 joints"):
        min_mpjpe(*skewed(2, N, M, K), root=root)  # type: ignore[arg-type]


def test_a_root_may_be_counted_from_the_end() -> None:
    x, y = skewed(2, N, M, K)
    np.testing.assert_array_equal(min_mpjpe(x, y, root=np.int64(-1)), min_mpjpe(x, y, root=K - 1))


@pytest.mark.parametrize(("value", "is_refused"), [(9.9e6, False), (1.1e7, True), (1e19, True), (1e25, True)])
def test_coordinates_beyond_ten_kilometres_count_as_not_finite(value: float, is_refused: bool) -> None:
    x, y = np.full((1, 1, 1, 3), -value, dtype="f4"), np.zeros((1, 1, 3), dtype="f4")
    with np.errstate(over="ignore"):
        assert Block(x, y).non_finite.all() == is_refused


# --- cutting ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("size", [4, 8])
def test_a_block_holds_about_as_many_bytes_as_it_should(size: int) -> None:
    assert block_length((200, 9999, 16, 3), f"f{size}") == BLOCK_BYTES // (200 * 16 * 3 * size) > 1


def test_a_block_has_at_least_one_pose_and_never_too_many() -> None:
    assert block_length((10**6, 5, 17, 3), "f8") == 1
    assert block_length((1, 10**6, 1, 1), "f4") == MOST_POSES


@given(
    st.integers(1, 9), st.integers(1, 4), st.integers(1, 5), st.integers(1, 3), st.integers(0, 6), st.integers(0, 10**6)
)
def test_blocks_of_every_length_join_to_one_block(m: int, n: int, k: int, d: int, length: int, seed: int) -> None:
    x, y = skewed(seed, n, m, k, d)
    random = np.random.default_rng(seed)
    where, follows = random.random((m, k)) < 0.7, random.random(m) < 0.7
    sequence: npt.NDArray[np.intp] = random.integers(0, 3, m)
    all_poses = Block(x, y, where, follows=follows, sequence=sequence)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("posecal.engine.block.BLOCK_BYTES", length * n * k * d * 8)
        blocks = [lay_out() for lay_out in iter_blocks(x, y, where, follows=follows, earlier=3, sequence=sequence)]
    assert [len(block.where) for block in blocks][:-1] == [max(length, 1)] * (len(blocks) - 1)
    for order in (1, 2, 3):
        for whole, *parts in zip(*(block.differences(order, "offsets") for block in (all_poses, *blocks)), strict=True):
            assert np.concatenate(parts).tobytes() == whole.tobytes(), order
    for name in ("offsets", "truth", "where"):
        joined = np.concatenate([getattr(block, name) for block in blocks])
        assert joined.tobytes() == np.ascontiguousarray(getattr(all_poses, name)).tobytes(), name
    for end in range(2):
        joined = np.concatenate([block.range_of_others[end] for block in blocks])
        np.testing.assert_array_equal(joined, all_poses.range_of_others[end])


def test_a_statistic_of_every_pose_comes_in_the_order_of_the_poses(
    arrays: tuple[Array, Array], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("posecal.engine.block.BLOCK_BYTES", 2 * N * K * D * 8)
    found = per_pose(lambda block: block.truth[:, 0, 0], *arrays)
    np.testing.assert_allclose(found, arrays[1][:, 0, 0])


@pytest.mark.parametrize("which", ["hypotheses", "truth"])
@pytest.mark.parametrize(("value", "what"), [(np.nan, "non-finite coordinates"), (1e8, "coordinates beyond 10 km")])
def test_functions_of_arrays_say_which_array_holds_what(which: str, value: float, what: str) -> None:
    x, y = skewed(0, 3, 5, 4, 3)
    (x[1] if which == "hypotheses" else y)[2, 3, 0] = value
    with pytest.raises(PoseDataError, match=rf"^{which}: {what}.* \(first: pose 2, joint 3\)"):
        mpjpe(x, y, unit="mm")
