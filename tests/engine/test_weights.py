"""Weights of hypotheses: every number is that of weighted sums, and of plain ones where the weights say nothing."""

from typing import Any

import numpy as np
import pytest

import posecal
from posecal.calibration.ranks import LEVELS
from posecal.engine.merge import merge_totals
from posecal.engine.weighted import effective_counts, effective_number, weighted_median, weighted_quantiles
from posecal.errors import PoseDataError
from posecal.metrics import auc, cps, crps, diversity, energy_score, min_mpjpe, mpjpe, pck, radius, variogram_score
from tests.helpers.samplers import gaussian

Array = np.ndarray[Any, Any]
N, M, K = 10, 90, 5
X, Y = gaussian(0, N, M, K)
RANDOM = np.random.default_rng(1)
LIVE = RANDOM.permuted(np.arange(N)[:, None] < RANDOM.integers(2, N + 1, M), axis=0)
W = np.where(LIVE, RANDOM.exponential(1, (N, M)), 0)
W /= W.sum(axis=0)
SPREAD = 1 / (W**2).sum(axis=0) >= 1.5
EQUAL = LIVE / LIVE.sum(axis=0)
LABELS = {"sequence": np.repeat(np.arange(9), 10).astype(str)}
OPTIONS: dict[str, Any] = {"unit": "mm", "axes": "NMKD", "root_joint": "none", "threads": 1}


def report_of(x: Array, metrics: str = "all", **options: Any) -> posecal.Report:
    return posecal.evaluate(x, Y, **{**OPTIONS, "labels": LABELS, "metrics": metrics, **options})


def live(m: int) -> tuple[Array, Array, Array]:
    """The hypotheses that are there, (n, 1, K, 3), the truth, and the weights, (n,), of one pose."""
    return X[LIVE[:, m], m : m + 1], Y[m : m + 1], W[LIVE[:, m], m]


def assert_same_numbers(found: posecal.Report, right: posecal.Report) -> None:
    values, expected = found.scalars(), right.scalars()
    assert len(values) > 15
    for name, value in values.items():
        assert value == pytest.approx(expected[name], rel=1e-9, abs=1e-12, nan_ok=True), name


def test_equal_weights_are_none() -> None:
    plain, weighted = report_of(X), report_of(X, weights=np.full((N, M), 1 / N))
    assert plain.metrics.keys() == weighted.metrics.keys()
    assert_same_numbers(weighted, plain)


def test_weights_that_differ_by_rounding_are_none() -> None:
    rounding = 1 + RANDOM.uniform(-2e-5, 2e-5, (N, M))
    plain, weighted = report_of(X), report_of(X, weights=rounding / rounding.sum(axis=0))
    assert plain.metrics.keys() == weighted.metrics.keys()
    assert_same_numbers(weighted, plain)


def test_weights_that_just_differ_have_nearly_the_numbers_of_equal_ones() -> None:
    differing = np.where(np.arange(N)[:, None] % 2, 1.0, 1.00011) * np.ones((N, M))
    found = report_of(X, "default, scores", weights=differing / differing.sum(axis=0))
    right = report_of(X, "default, scores")
    assert found.totals.spec.has_weights
    for name in found.metrics.keys() & right.metrics.keys() - {"ece_mean", "ece_worst"}:
        assert found[name] == pytest.approx(right[name], rel=1e-3, abs=1e-4, nan_ok=True), name


def test_equal_weights_of_those_that_are_there_are_those_of_nan() -> None:
    garbage = np.where(LIVE[..., None, None], X, 1e6)
    found, right = report_of(garbage, weights=EQUAL), report_of(np.where(LIVE[..., None, None], X, np.nan))
    assert found.metrics.keys() == right.metrics.keys()
    assert_same_numbers(found, right)
    assert "ece" in found.metrics
    assert found["effective_hypotheses"] == pytest.approx(LIVE.sum(axis=0).mean())


def test_weights_of_zero_are_left_out() -> None:
    """Two hypotheses more of weight 0 at all poses give the numbers without them."""
    weights = RANDOM.dirichlet(np.ones(N), M).T
    more = np.concatenate([X[:1] + 500, X, X[:1] - 500])
    padded = np.concatenate([np.zeros((1, M)), weights, np.zeros((1, M))])
    assert_same_numbers(
        report_of(more, "default, scores", weights=padded), report_of(X, "default, scores", weights=weights)
    )


def naive_energy(x: Array, y: Array, w: Array) -> float:
    flat, truth = x.reshape(len(x), -1), y.ravel()
    pairs = sum(w[i] * w[j] * np.linalg.norm(flat[i] - flat[j]) for i in range(len(w)) for j in range(len(w)) if i != j)
    error = sum(w[i] * np.linalg.norm(flat[i] - truth) for i in range(len(w)))
    return float(error - pairs / 2 / (1 - (w**2).sum()))


def naive_crps(x: Array, y: Array, w: Array) -> float:
    columns = zip(x.reshape(len(x), -1).T, y.ravel(), strict=True)
    return float(np.mean([naive_energy(column, np.array(true), w) for column, true in columns]))


def naive_variogram(x: Array, y: Array, w: Array) -> float:
    found = []
    for k in range(K):
        for j in range(k):
            roots = np.linalg.norm(x[:, 0, k] - x[:, 0, j], axis=-1) ** 0.5
            mean, true = (w * roots).sum(), np.linalg.norm(y[0, k] - y[0, j]) ** 0.5
            variance = (w * (roots - mean) ** 2).sum() / (1 - (w**2).sum())
            found.append((true - mean) ** 2 - (w**2).sum() * variance)
    return float(np.mean(found))


def naive_median(values: Array, w: Array) -> float:
    order = np.argsort(values)
    return float(np.interp(0.5, (np.cumsum(w[order]) - w[order] / 2) / w.sum(), values[order]))


def naive_rank(x: Array, y: Array, w: Array) -> Array:
    """Weights of the truth's rank of one joint, with the share 1 / (n + 1), n = 1 / Σ w²."""
    n = 1 / (w**2).sum()
    shares = np.append(w * n, 1) / (n + 1)
    pool = np.concatenate([x, y[None]])
    centre = np.array([naive_median(column, shares) for column in pool.T])
    distances = np.linalg.norm(pool - centre, axis=1)
    before = shares[:-1][distances[:-1] < distances[-1] - 1e-9].sum()
    return np.clip((LEVELS - before) / shares[-1], 0, 1)


def mean_of(naive: Any, poses: Array = SPREAD) -> float:
    return float(np.mean([naive(*live(m)) for m in np.flatnonzero(poses)]))


def test_numbers_of_a_report_are_naive_sums() -> None:
    report = report_of(X, "all", weights=W)

    def errors(x: Array, y: Array) -> Array:
        return np.linalg.norm(x - y, axis=-1).mean(axis=(1, 2))

    def deviation(x: Array, y: Array, w: Array) -> float:
        mean = (w[:, None, None, None] * x).sum(axis=0)
        squares = (w[:, None, None, None] * (x - mean) ** 2).sum(axis=0) / (1 - (w**2).sum())
        return float(np.sqrt(squares).mean())

    right = {
        "min_mpjpe": lambda x, y, w: errors(x, y).min(),
        "mpjpe": lambda x, y, w: (w * errors(x, y)).sum(),
        "worst_mpjpe": lambda x, y, w: errors(x, y).max(),
        "median_mpjpe": lambda x, y, w: naive_median(errors(x, y), w),
        "mean_pose_mpjpe": lambda x, y, w: errors((w[:, None, None, None] * x).sum(axis=0)[None], y)[0],
        "energy_score": naive_energy,
        "crps": naive_crps,
        "variogram_score": naive_variogram,
        "diversity": deviation,
        "effective_hypotheses": lambda x, y, w: 1 / (w**2).sum(),
    }
    for name, naive in right.items():
        counted = SPREAD if name in {"energy_score", "crps", "variogram_score", "diversity"} else SPREAD | True
        assert report[name] == pytest.approx(mean_of(naive, counted), rel=1e-9), name
    curves = np.array(
        [
            np.mean([naive_rank(x[:, 0, k], y[0, k], w) for x, y, w in map(live, np.flatnonzero(SPREAD))], axis=0)
            for k in range(K)
        ]
    )
    median = np.median(curves, axis=0)
    assert report["ece"] == pytest.approx(np.abs(median - LEVELS).mean(), abs=1e-9)
    found = posecal.calibration_curve(X, Y, weights=W, unit="mm", axes="NMKD")
    np.testing.assert_allclose(found.joints, curves, atol=1e-9)


def test_arrays_give_what_reports_give() -> None:
    report = report_of(X, "all", weights=W)
    options: dict[str, Any] = {"weights": W, "unit": "mm", "axes": "NMKD"}
    for name, function, extra in (
        ("min_mpjpe", min_mpjpe, {}),
        ("mpjpe", mpjpe, {}),
        ("median_mpjpe", mpjpe, {"of": "median"}),
        ("mean_pose_mpjpe", mpjpe, {"of": "mean_pose"}),
        ("pa_min_mpjpe", min_mpjpe, {"align": "similarity"}),
        ("pck", pck, {}),
        ("auc", auc, {}),
        ("cps", cps, {}),
        ("energy_score", energy_score, {}),
        ("crps", crps, {}),
        ("variogram_score", variogram_score, {}),
        ("diversity", diversity, {}),
        ("radius_50", radius, {"share": 0.5}),
        ("radius_90", radius, {"share": 0.9}),
    ):
        assert np.nanmean(function(X, Y, **options, **extra)) == pytest.approx(report[name], rel=1e-6), name
    assert posecal.ece(X, Y, **options) == pytest.approx(report["ece"], abs=1e-12)
    turned = posecal.ece(X.swapaxes(0, 1), Y, weights=W.T, unit="mm", axes="MNKD")
    assert turned == pytest.approx(report["ece"], abs=1e-12)


@pytest.mark.parametrize("select", ["own", "linked", "mean"])
def test_shares_of_correct_joints_are_by_the_weights(select: Any) -> None:
    found = pck(X, Y, weights=W, select=select, threshold=60, unit="mm", axes="NMKD")
    for m in range(0, M, 9):
        x, y, w = live(m)
        distances = np.linalg.norm(x - y, axis=-1)[:, 0]
        right = (distances < 60).mean(axis=1)
        value = {"own": right.max(), "linked": right[distances.mean(axis=1).argmin()], "mean": (w * right).sum()}
        assert found[m] == pytest.approx(value[select])


def test_angles_are_weighted_on_the_circle() -> None:
    """A turn by 180 degrees, to where 360 is 0, changes nothing; far from there CRPS and error are those on a line."""
    x, y = (180 + (poses - X.mean(axis=0))[..., :1] / 2 for poses in (X, Y))
    options: dict[str, Any] = {**OPTIONS, "unit": "deg", "weights": W, "metrics": "ece, crps, mpjpe, coordinate_pit"}
    first, turned = (posecal.evaluate((x + by) % 360, (y + by) % 360, **options) for by in (0, 180))
    for name in ("ece", "crps", "mpjpe", "coordinate_pit"):
        assert first[name] == pytest.approx(turned[name], rel=1e-6), name
    plain = posecal.evaluate(x, y, **{**options, "unit": "none"})
    for name in ("ece", "crps", "mpjpe", "coordinate_pit"):
        assert first[name] == pytest.approx(plain[name], rel=1e-6), name


def parts_of(weights: list[Array | None]) -> list[posecal.Evaluation]:
    parts = []
    for number, some in enumerate(weights):
        rows = slice(30 * number, 30 * number + 30)
        evaluation = posecal.Evaluation(unit="mm", axes="NMKD", root_joint="none", metrics="default, scores")
        evaluation.update(X[:, rows], Y[rows], weights=some, sequence=LABELS["sequence"][rows])
        parts.append(evaluation)
    return parts


@pytest.mark.parametrize("plain", [[], [0], [1, 2], [0, 1, 2]])
def test_batches_shards_and_files_give_what_one_call_gives(plain: list[int], tmp_path: Any) -> None:
    """Also where some have no weights: all their hypotheses count alike."""
    weights, given = W.copy(), [W[:, 30 * part : 30 * part + 30] for part in range(3)]
    for part in plain:
        weights[:, 30 * part : 30 * part + 30] = 1 / N
    batches = [None if part in plain else some for part, some in enumerate(given)]
    whole = report_of(X, "default, scores", weights=weights)
    evaluation = posecal.Evaluation(unit="mm", axes="NMKD", root_joint="none", metrics="default, scores")
    for number, some in enumerate(batches):
        rows = slice(30 * number, 30 * number + 30)
        evaluation.update(X[:, rows], Y[rows], weights=some, sequence=LABELS["sequence"][rows])
    np.savez(tmp_path / "h.npz", hypotheses=X, unit="mm", weights=weights)
    np.savez(tmp_path / "t.npz", truth=Y, unit="mm", sequence=LABELS["sequence"])
    for found in (
        evaluation.compute(),
        posecal.Report(merge_totals([part.totals() for part in parts_of(batches)])),
        posecal.evaluate(tmp_path / "h.npz", tmp_path / "t.npz", root_joint="none", metrics="default, scores"),
    ):
        assert found.metrics.keys() == whole.metrics.keys()
        assert_same_numbers(found, whole)


def test_results_of_weighted_hypotheses_are_saved(tmp_path: Any) -> None:
    report = report_of(X, "default, rank_tests", weights=W)
    posecal.save_totals(report.totals, tmp_path / "r.npz")
    loaded = posecal.Report(posecal.load_totals(tmp_path / "r.npz"))
    assert loaded.totals.spec.has_weights
    assert_same_numbers(loaded, report)


def test_groups_skills_and_occlusion_are_given() -> None:
    occluded = RANDOM.random((M, K)) < 0.3
    report = report_of(X, "default, scores", weights=W, by="occlusion", occluded=occluded, reference="climatology")
    assert report["energy_skill"] > 0.5
    assert 0 <= report.value("ece", "occlusion=occluded") < 0.1
    mean = [
        (np.linalg.norm(X[:, m] - Y[m], axis=-1)[:, occluded[m]].mean(axis=1) * W[:, m]).sum()
        for m in range(M)
        if occluded[m].any()
    ]
    assert report.value("mpjpe", "occlusion=occluded") == pytest.approx(np.mean(mean))


def test_what_takes_no_weights_is_left_out_with_one_line() -> None:
    report = report_of(X, "default, scores", weights=np.where(W > 0, W, 1e-9) / np.where(W > 0, W, 1e-9).sum(axis=0))
    line = next(remark for remark in report.remarks if remark.startswith("left out: "))
    assert line.endswith("which need hypotheses of equal weight.")
    assert not {"ece_paper", "min_mpjpe_at_5", "mpjve", "jitter", "brier"} & report.metrics.keys()
    with pytest.raises(PoseDataError, match="needs hypotheses of equal weight"):
        report_of(X, "brier", weights=RANDOM.dirichlet(np.ones(N), M).T)
    with pytest.raises(PoseDataError, match="definition: paper; expected exchangeable"):
        posecal.ece(X, Y, weights=RANDOM.dirichlet(np.ones(N), M).T, definition="paper", unit="mm", axes="NMKD")


@pytest.mark.parametrize("absent", [{"x": np.where(LIVE[..., None, None], X, np.nan)}, {"x": X, "weights": W}])
def test_the_error_of_a_hypothesis_by_its_number_is_left_out_where_some_are_absent(absent: dict[str, Any]) -> None:
    """Numbers of hypotheses are others where those before are absent; one of the highest score is the same."""
    names = {"spread_error_correlation", "ause", "aurc", "excess_aurc", "failure_auroc"}
    of_mode = posecal.Protocol(metrics="default", single_pose="mode", mode=N - 1)
    report = report_of(**absent, metrics=None, protocol=of_mode)
    assert not names & report.metrics.keys()
    (line,) = [remark for remark in report.remarks if remark.startswith("left out: ")]
    assert "spread_error_correlation" in line
    with pytest.raises(PoseDataError, match=r"ause needs (as many hypotheses|hypotheses of equal weight)"):
        report_of(**absent, metrics=None, protocol=posecal.Protocol(metrics="ause", single_pose="mode", mode=0))
    assert names <= report_of(X, metrics=None, protocol=of_mode).metrics.keys()
    of_score = posecal.Protocol(metrics="default", single_pose="mode", failure_threshold=75)
    scores = RANDOM.random((N, M)) + 0.1
    by_score = report_of(**absent, metrics=None, scores=scores, protocol=of_score)
    best = np.where(LIVE, scores, 0).argmax(axis=0)
    error = np.linalg.norm(X[best, np.arange(M)] - Y, axis=-1).mean(axis=1)
    assert 0.1 < by_score["failure_rate"] < 0.9
    spread = effective_number(absent.get("weights", LIVE * 1.0).T) >= 1.5  # others have none that errors could follow
    assert by_score["failure_rate"] == pytest.approx((error > 75)[spread].mean())


def test_remarks_say_what_the_weights_are_worth_and_that_scores_are_no_weights() -> None:
    number = (1 / (W**2).sum(axis=0)).mean()
    found = next(remark for remark in report_of(X, "ece", weights=W).remarks if "by their weights" in remark)
    assert f"effective N = {number:.1f} (mean of 1 / Σ w²), of up to {N}. Below" in found
    scored = report_of(X, "ece", scores=RANDOM.random((N, M)))
    assert any(remark.startswith("scores are not used by calibration") for remark in scored.remarks)
    assert not any("scores are not" in remark for remark in report_of(X, "mpjpe", scores=RANDOM.random((N, M))).remarks)


def test_poses_with_one_hypothesis_of_nearly_all_weight_have_no_spread() -> None:
    """As where it is the only one: fair scores divide by 1 - Σ w², which is rounding. Errors are of all hypotheses."""
    weights = RANDOM.dirichlet(np.full(N, 100.0), M).T
    nearly, only = weights.copy(), weights.copy()
    nearly[:, :9], only[:, :9] = 1e-7, 0
    nearly[0, :9], only[0, :9] = 1 - (N - 1) * 1e-7, 1
    found, right = (report_of(X, "default, scores, rank_tests", weights=some) for some in (nearly, only))
    part = posecal.evaluate(X[:, 9:], Y[9:], **OPTIONS, metrics="default, scores, rank_tests", weights=weights[:, 9:])
    for name in (
        "ece",
        "signed_area",
        "energy_score",
        "crps",
        "variogram_score",
        "diversity",
        "radius_90",
        "average_rank",
    ):
        assert found[name] == pytest.approx(right[name], rel=1e-9), name
        assert found[name] == pytest.approx(part[name], rel=1e-9), name
    assert found["mpjpe"] == pytest.approx(right["mpjpe"], rel=1e-5)
    assert found["min_mpjpe"] < right["min_mpjpe"]
    for report in (found, right):
        assert any(remark.startswith("9 poses of 90 have one hypothesis, or") for remark in report.remarks)


def test_the_floor_is_that_of_the_effective_number() -> None:
    report = report_of(X, "ece", weights=W)
    number = round((1 / (W**2).sum(axis=0)).mean())
    assert report["ece_floor"] == posecal.perfect_sampler(number, SPREAD.sum(), K).mean


def test_weighted_statistics_by_hand() -> None:
    values, weights = np.array([[5.0, 1, 3]]), np.array([[0.25, 0.25, 0.5]])
    assert weighted_median(values, weights).tolist() == [3]
    assert weighted_median(values, np.array([[0.5, 0.25, 0.25]])).tolist() == pytest.approx([3 + 2 / 3])
    assert weighted_median(values, np.array([[0.01, 0.98, 0.01]])).tolist() == pytest.approx([1 + 2 * 0.01 / 0.495])
    assert weighted_median(np.array([4.0]), np.array([1.0])) == 4
    assert weighted_quantiles(values, weights, (0.25, 0.26, 0.75, 1.0)).tolist() == [[1, 3, 3, 5]]
    assert effective_number(weights).tolist() == effective_number(7 * weights).tolist() == [1 / 0.375]
    np.testing.assert_allclose(effective_counts(values > 2, weights), [0.75 / 0.375])


def test_a_quantile_is_not_reached_where_more_than_rounding_lacks() -> None:
    """Weights within 1e-4 of equal ones have the quantiles of these: sums are off by 1e-4 q (1 - q) at most."""
    values = np.array([1.0, 2.0])
    for lacking, value in ((1e-5, 1), (1e-4, 2)):
        weights = np.array([0.9 - lacking, 0.1 + lacking])
        assert weighted_quantiles(values, weights, (0.9,)).tolist() == [value]
