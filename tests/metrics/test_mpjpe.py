"""The MPJPE family, against the naive formulas."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from posecal.errors import PoseDataError
from posecal.geometry.procrustes import ALIGNMENTS, Alignment
from posecal.metrics import min_mpjpe, mpjpe
from posecal.metrics.mpjpe import OF_ERRORS, OfErrors, reduce_errors
from posecal.metrics.position import OfPoses
from tests.helpers import oracles
from tests.helpers.random_worlds import Array, Mask, mostly, skewed

N, M, K = 6, 11, 5
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
    x, y, w = oracles.relative(x, root), oracles.relative(y, root), oracles.relative_mask(w, root)
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
    np.testing.assert_allclose(
        mpjpe(x, y, of=of, where=w, axes="NMKD"), expected(x, y, w, of, "none", None), rtol=1e-12
    )


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
    without = min_mpjpe(oracles.relative(x, 0)[:, :, 1:], oracles.relative(y, 0)[:, 1:])
    ratio = without / min_mpjpe(x, y, root=0)
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
    assert [mpjpe(x, y, of=of).item() for of in ("mean", "min", "worst")] == [1.5, 0.5, 2.5]  # type: ignore[arg-type]


def test_a_pose_without_a_joint_that_counts_has_no_error(arrays: tuple[Array, Array], where: Mask) -> None:
    for of in (*OF_ERRORS, *OF_POSES):
        for align in ALIGNMENTS:
            found = mpjpe(*arrays, of=of, align=align, where=where)  # type: ignore[arg-type]
            assert np.flatnonzero(np.isnan(found)).tolist() == [4]


def test_relative_to_a_root_that_does_not_count_a_pose_has_no_error(arrays: tuple[Array, Array]) -> None:
    where = np.ones((M, K), dtype=bool)
    where[[2, 5], 1] = False
    found = min_mpjpe(*arrays, where=where, root=1)
    assert np.flatnonzero(np.isnan(found)).tolist() == [2, 5]
    others = np.delete(np.arange(M), [2, 5])
    np.testing.assert_allclose(found[others], min_mpjpe(*arrays, root=1)[others])


def test_a_root_that_counts_in_no_pose_is_refused(arrays: tuple[Array, Array]) -> None:
    where = np.ones((M, K), dtype=bool)
    where[:, 1] = False
    with pytest.raises(PoseDataError, match=r"^where: the root 1 counts in no pose; expected some\.$"):
        min_mpjpe(*arrays, where=where, root=1)


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


@pytest.mark.parametrize("mode", [6, -7])
def test_the_mode_s_index_is_one_of_the_hypotheses(arrays: tuple[Array, Array], mode: int) -> None:
    with pytest.raises(PoseDataError, match=rf"mode: {mode}; expected the index of one of 6 hypotheses\."):
        mpjpe(*arrays, of="mode", mode=mode)


@pytest.mark.parametrize("of", OF_ERRORS)
@pytest.mark.parametrize("n", [1, 2, 5])
def test_n_errors_become_one(of: OfErrors, n: int) -> None:
    errors = np.random.default_rng(n).gamma(2, 30, (4, 3, n))
    found = reduce_errors(errors, of)
    for place in np.ndindex(4, 3):
        np.testing.assert_allclose(found[place], oracles.of_errors(list(errors[place]), of))
