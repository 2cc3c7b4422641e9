"""Weights of hypotheses, as they are given: what is refused, and copies that become weights."""

from typing import Any

import numpy as np
import pytest

import posecal
from posecal.data.weights import are_unequal
from posecal.errors import PoseDataError
from tests.helpers.samplers import gaussian

Array = np.ndarray[Any, Any]
N, M, K = 6, 40, 4
X, Y = gaussian(0, N, M, K)
W = np.random.default_rng(1).dirichlet(np.ones(N), M).T


def data_of(weights: Any, **options: Any) -> posecal.PoseData:
    return posecal.PoseData(X, Y, unit="mm", axes="NMKD", weights=weights, **options)


def test_weights_are_normalized_and_equal_ones_dropped() -> None:
    weights = data_of(W * 1.001).weights
    assert weights is not None
    np.testing.assert_allclose(weights, W, rtol=1e-12)
    assert data_of(np.full((N, M), 1 / N)).weights is None
    assert data_of(None).weights is None
    absent = np.where(np.arange(N)[:, None] < 4, 0.25, 0) * np.ones((N, M))
    np.testing.assert_array_equal(data_of(absent).weights, absent)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda w: w[:, :-1], r"^hypotheses: weights \(6, 39\); expected \(N, M\) = \(6, 40\)\."),
        (
            lambda w: np.where(np.arange(M) == 7, -w, w),
            r"^weights: 6 of 240 are below 0 or not finite; expected numbers",
        ),
        (lambda w: np.where(np.arange(M) == 7, np.nan, w), r"^weights: 6 of 240 are below 0 or not finite"),
        (
            lambda w: np.where(np.arange(M) == 7, 2 * w, w),
            r"^hypotheses: weights: sums from 2 to 2 in 1 of 40 frames \(first: 7\); expected 1 for each pose\.",
        ),
        (lambda w: 0 * w, r"sums from 0 to 0 in 40 of 40 frames \(first: 0, 1, 2 and 37 more\)"),
        (lambda w: [["a"]], r"^weights: dtype <U1; expected real numbers"),
    ],
)
def test_what_can_be_no_weights_is_refused(change: Any, message: str) -> None:
    with pytest.raises(PoseDataError, match=message):
        data_of(change(W))
    with pytest.raises(PoseDataError, match=message.replace("hypotheses: ", "")):
        posecal.ece(X, Y, weights=change(W), unit="mm", axes="NMKD")


def test_a_file_says_of_which_frames_the_sum_is_not_one(tmp_path: Any) -> None:
    names = [f"frame {number:02}" for number in range(M)]
    wrong = W.copy()
    wrong[:, 3:5] *= 0.5
    np.savez(tmp_path / "h.npz", hypotheses=X, weights=wrong, frame_id=names[::-1], unit="mm")
    np.savez(tmp_path / "t.npz", truth=Y, frame_id=names, unit="mm")
    message = r"^h.npz: weights: sums from 0.5 to 0.5 in 2 of 40 frames \(first: frame 35, frame 36\); expected 1"
    with pytest.raises(PoseDataError, match=message):
        posecal.PoseData(tmp_path / "h.npz", tmp_path / "t.npz")


def test_weights_follow_frames_and_layout(tmp_path: Any) -> None:
    names = [f"{number:02}" for number in range(M)]
    np.savez(tmp_path / "h.npz", hypotheses=X.swapaxes(0, 1), axes="MNKD", weights=W.T, frame_id=names[::-1], unit="mm")
    np.savez(tmp_path / "t.npz", truth=Y, frame_id=names, unit="mm")
    data = posecal.PoseData(tmp_path / "h.npz", tmp_path / "t.npz")
    np.testing.assert_allclose(data.weights, W[:, ::-1], rtol=1e-12)
    np.testing.assert_allclose(data.select([4, 2]).weights, W[:, [35, 37]], rtol=1e-12)


def test_the_first_hypotheses_are_taken_of_equal_weights_only() -> None:
    equal = np.where(np.arange(N)[:, None] == 1, 0, 1 / (N - 1)) * np.ones((N, M))
    np.testing.assert_allclose(data_of(equal, n_hypotheses=3).weights, np.array([[0.5], [0], [0.5]]) * np.ones(M))
    with pytest.raises(
        PoseDataError, match=r"weights: not equal in 40 of 40 frames .*expected all 6 hypotheses of such"
    ):
        data_of(W, n_hypotheses=3)
    with pytest.raises(PoseDataError, match=r"weights: all of the first 3 are 0 in 40 of 40 frames"):
        data_of(np.where(np.arange(N)[:, None] < 3, 0, 1 / 3) * np.ones((N, M)), n_hypotheses=3)


def test_a_hypothesis_with_a_weight_must_be_finite() -> None:
    x = X.copy()
    x[2, 5] = np.nan
    with pytest.raises(PoseDataError, match="non-finite coordinates in 1 of 40 frames"):
        posecal.evaluate(x, Y, weights=W, unit="mm", axes="NMKD", metrics="mpjpe")
    with pytest.raises(PoseDataError, match=r"non-finite coordinates \(first: pose 5, joint 0\)"):
        posecal.metrics.mpjpe(x, Y, weights=W, unit="mm", axes="NMKD")
    without = np.where((np.arange(N)[:, None] == 2) & (np.arange(M) == 5), 0, W)
    report = posecal.evaluate(x, Y, weights=without / without.sum(axis=0), unit="mm", axes="NMKD", metrics="mpjpe")
    assert np.isfinite(report["mpjpe"])


def test_weights_equal_up_to_rounding_are_equal() -> None:
    assert are_unequal(np.array([[0.5, 0.5, 0, 0.4], [0.5, 0.5 + 1e-8, 1, 0.6]])).tolist() == [
        False,
        False,
        False,
        True,
    ]


def test_copies_become_weights() -> None:
    copied = np.random.default_rng(2).permuted(np.repeat(np.arange(N), 5))
    distinct, weights = posecal.collapse_copies(X[copied])
    _, first = np.unique(copied, return_index=True)
    np.testing.assert_array_equal(distinct, X[copied[np.sort(first)]])
    np.testing.assert_array_equal(weights, np.full((N, M), 1 / N))
    turned, _ = posecal.collapse_copies(X[copied].swapaxes(0, 1), axes="MNKD")
    np.testing.assert_array_equal(turned, distinct)
    with pytest.raises(PoseDataError, match=r"^hypotheses \(40, 4, 3\): expected \(N, M, K, D\)\."):
        posecal.collapse_copies(X[0])


def test_copies_of_unlike_numbers_leave_absent_ones() -> None:
    x = X.copy()
    x[1:4, 0] = x[0, 0]
    distinct, weights = posecal.collapse_copies(x)
    assert weights[:, 0].tolist() == [4 / 6, 1 / 6, 1 / 6, 0, 0, 0]
    assert np.isnan(distinct[3:, 0]).all()
    np.testing.assert_array_equal(distinct[:, 1:], X[:, 1:])
    report = posecal.evaluate(distinct, Y, weights=weights, unit="mm", axes="NMKD", root_joint="none", metrics="mpjpe")
    assert report["mpjpe"] == pytest.approx(posecal.metrics.mpjpe(x, Y, unit="mm", axes="NMKD").mean())


def test_absent_hypotheses_have_no_share() -> None:
    x = np.concatenate([X, np.full((4, *X.shape[1:]), np.nan)])
    x[1, 0], x[2, 1] = x[0, 0], np.nan
    distinct, weights = posecal.collapse_copies(x)
    assert weights[:, 0].tolist() == [2 / 6, 1 / 6, 1 / 6, 1 / 6, 1 / 6, 0]
    assert weights[:, 1].tolist() == [1 / 5] * 5 + [0]
    np.testing.assert_array_equal(distinct[:5, 1], X[[0, 1, 3, 4, 5], 1])
    np.testing.assert_array_equal(weights[:, 2:], np.full((6, M - 2), 1 / 6))
    x[:, 3] = np.nan
    assert not posecal.collapse_copies(x)[1][:, 3].any()


def test_collapsed_copies_have_the_numbers_of_the_draws() -> None:
    options: dict[str, Any] = {"unit": "mm", "axes": "NMKD", "root_joint": "none", "metrics": "default, scores"}
    copied = np.repeat(X, 20, axis=0)
    distinct, weights = posecal.collapse_copies(copied)
    draws, as_they_stand = posecal.evaluate(X, Y, **options), posecal.evaluate(copied, Y, **options)
    assert posecal.evaluate(distinct, Y, weights=weights, **options).scalars() == pytest.approx(
        draws.scalars(), nan_ok=True
    )
    assert as_they_stand["energy_score"] > 1.05 * draws["energy_score"]
    remark = next(remark for remark in as_they_stand.remarks if "equal another" in remark)
    assert remark.startswith("hypotheses: 4,560 hypotheses in 40 of 40 frames")
    assert "which leaves 240 distinct ones there." in remark


def test_recalibration_refuses_unequal_weights(tmp_path: Any) -> None:
    with pytest.raises(PoseDataError, match=r"^hypotheses: weights are not equal in 40 of 40 frames; expected"):
        posecal.fit_spread(X, Y, unit="mm", axes="NMKD", weights=W)
    np.savez(tmp_path / "h.npz", hypotheses=X, weights=W, unit="mm")
    map_ = posecal.fit_spread(X, Y, unit="mm", axes="NMKD", root_joint="none")
    with pytest.raises(PoseDataError, match=r"^h.npz: weights are not equal in 40 of 40 frames; expected"):
        posecal.recalibration.apply_map(map_, tmp_path / "h.npz", tmp_path / "out.npz", axes="NMKD", root_joint="none")


def test_a_reference_has_no_weights() -> None:
    reference = data_of(W)
    with pytest.raises(PoseDataError, match="has weights; expected a reference whose hypotheses all count alike"):
        posecal.evaluate(data_of(None), reference=reference, metrics="scores")


def test_conversion_keeps_weights(tmp_path: Any) -> None:
    np.savez(tmp_path / "h.npz", hypotheses=X.swapaxes(0, 1), weights=W.T)
    members, _ = posecal.convert(tmp_path / "h.npz", axes="MNKD", unit="mm")
    np.testing.assert_array_equal(members["weights"], W)
    np.savez(tmp_path / "t.npz", truth=Y, weights=W)
    assert "weights" not in posecal.convert(tmp_path / "t.npz", unit="mm")[0]
