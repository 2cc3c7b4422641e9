"""Angles of any spread, wherever the truth lies: every number on the circle, against plain NumPy."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import posecal
from posecal import metrics
from posecal.calibration import interval_coverage, interval_width
from posecal.errors import PoseDataError

Array = np.ndarray[Any, Any]
N, M, K = 12, 40, 2
SEQUENCE = np.repeat(np.arange(8), 5).astype(str)
CONVENTIONS: dict[str, Callable[[Array], Array]] = {
    "-180 to 180": lambda angles: (angles + 180) % 360 - 180,
    "0 to 360": lambda angles: angles % 360,
    "any turns": lambda angles: angles + 360 * np.round(np.sin(angles * 1000) * 2),
}
SPREADS = {"narrow": (25.0, 0.0), "wide": (100.0, 0.0), "very wide": (170.0, 40.0), "opposite": (50.0, 180.0)}


def angles(spread: float, away: float, convention: str = "-180 to 180", n: int = N) -> tuple[Array, Array]:
    """Hypotheses (N, M, K, 1) of a spread about a centre, and truths (M, K, 1) of the same, as far away from it."""
    random, write = np.random.default_rng(7), CONVENTIONS[convention]
    centre = random.uniform(-180, 180, (M, K, 1))
    x = centre + random.normal(0, spread, (n, M, K, 1))
    return write(x), write(centre + away + random.normal(0, spread, (M, K, 1)))


# --- the numbers by plain NumPy -----------------------------------------------------------------------------------


def arc(a: Array, b: Array) -> Array:
    return np.abs((a - b + 180) % 360 - 180)


def mean_of(x: Array) -> Array:
    return np.degrees(np.angle(np.exp(1j * np.radians(x)).mean(axis=0)))


def unwrapped(x: Array) -> Array:
    about = mean_of(x)
    return about + (x - about + 180) % 360 - 180


def pairs(x: Array, distance: Callable[[Array, Array], Array]) -> Array:
    return sum(distance(x[i], x[j]) for i in range(len(x)) for j in range(len(x)) if i != j) / (len(x) * (len(x) - 1))


def chord(a: Array, b: Array) -> Array:
    """Distance of points on a circle of circumference 360, of all joints and coordinates together."""
    apart = 360 / np.pi * np.sin(np.radians(a - b) / 2)
    return np.sqrt((apart**2).sum(axis=(-2, -1)))


def weights(pool: Array, q: Array) -> Array:
    """How far inside each level the rank of the last of N + 1 numbers lies, those that tie sharing theirs."""
    n, ties = len(pool) - 1, np.abs(pool[:-1] - pool[-1]) < 1e-9
    less = ((pool[:-1] < pool[-1]) & ~ties).sum(axis=0)
    return np.clip(((n + 1) * q - less) / (ties.sum(axis=0) + 1), 0, 1)


def curve(x: Array, y: Array) -> Array:
    """Mean over poses of how far inside each level the truth's distance from the pooled median lies, (K, 21)."""
    pool = np.concatenate([x, y[None]])
    return weights(arc(pool, np.median(unwrapped(pool), axis=0)), np.arange(21) / 20).mean(axis=0)


def expected(x: Array, y: Array) -> dict[str, Array]:
    """Each number per pose, (M,)."""
    n, flat, middle, pool = len(x), unwrapped(x), np.median(unwrapped(x), axis=0), np.concatenate([x, y[None]])
    errors = arc(x, y).mean(axis=(2, 3))
    weibull = np.quantile(flat, [0.25, 0.75], axis=0, method="weibull")
    below, above = (weights(unwrapped(pool), np.array(q))[..., 0] for q in (0.25, 0.75))
    return {
        "mpjpe": errors.mean(axis=0),
        "min_mpjpe": errors.min(axis=0),
        "mean_pose_mpjpe": arc(mean_of(x), y).mean(axis=(1, 2)),
        "median_pose_mpjpe": arc(middle, y).mean(axis=(1, 2)),
        "crps": (arc(x, y).mean(axis=0) - pairs(x, arc) / 2).mean(axis=(1, 2)),
        "energy_score": chord(x, y).mean(axis=0) - pairs(x, chord) / 2,
        "diversity": flat.std(axis=0, ddof=1).mean(axis=(1, 2)),
        "radius_50": np.sort(arc(x, middle), axis=0)[n // 2 - 1].mean(axis=(1, 2)),
        "interval_width_50": (weibull[1] - weibull[0]).mean(axis=(1, 2)),
        "interval_coverage_50": (above - below).mean(axis=1),
    }


FUNCTIONS: dict[str, Callable[..., Array]] = {
    "mpjpe": metrics.mpjpe,
    "min_mpjpe": metrics.min_mpjpe,
    "mean_pose_mpjpe": lambda *data, **options: metrics.mpjpe(*data, of="mean_pose", **options),
    "median_pose_mpjpe": lambda *data, **options: metrics.mpjpe(*data, of="median_pose", **options),
    "crps": metrics.crps,
    "energy_score": metrics.energy_score,
    "diversity": metrics.diversity,
    "radius_50": metrics.radius,
    "interval_width_50": lambda *data, **options: interval_width(*data, level=0.5, **options),
    "interval_coverage_50": lambda *data, **options: interval_coverage(*data, level=0.5, **options),
}


# --- tests --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("convention", CONVENTIONS)
@pytest.mark.parametrize("spread", SPREADS)
def test_every_number_of_angles_is_that_of_the_circle(spread: str, convention: str) -> None:
    x, y = angles(*SPREADS[spread], convention)
    found = posecal.evaluate(x, y, unit="deg", axes="NMKD", metrics=list(FUNCTIONS), threads=1)
    for name, values in expected(x, y).items():
        assert found[name] == pytest.approx(values.mean(), rel=1e-9, abs=1e-9), name
        np.testing.assert_allclose(FUNCTIONS[name](x, y, unit="deg"), values, rtol=1e-9, atol=1e-9, err_msg=name)
        of_radians = FUNCTIONS[name](np.radians(x), np.radians(y), unit="rad")
        np.testing.assert_allclose(of_radians, values, rtol=1e-6, atol=1e-9, err_msg=name)


@pytest.mark.parametrize("n", [11, 12])
@pytest.mark.parametrize("spread", SPREADS)
def test_calibration_of_angles_is_that_of_arcs_about_the_pooled_median(spread: str, n: int) -> None:
    x, y = angles(*SPREADS[spread], n=n)
    found = posecal.evaluate(x, y, unit="deg", axes="NMKD", metrics="ece, coverage_90", threads=1)
    curves = curve(x, y)
    np.testing.assert_allclose(found.calibration().joints, curves, atol=1e-12)
    error = np.abs(np.median(curves, axis=0) - np.arange(21) / 20).mean()
    assert found["ece"] == pytest.approx(error, abs=1e-12)
    assert posecal.ece(x, y, unit="deg") == pytest.approx(error, abs=1e-12)
    np.testing.assert_allclose(posecal.calibration_curve(x, y, unit="deg").joints, curves, atol=1e-12)


@pytest.mark.parametrize("definition", ["paper", "reference"])
def test_the_other_definitions_count_arcs_about_their_own_centres(definition: Any) -> None:
    x, y = angles(*SPREADS["very wide"])
    rising = np.sort(unwrapped(x), axis=0)
    centre = (rising[N // 2 - 1] + rising[N // 2]) / 2 if definition == "paper" else rising[N // 2 - 1]
    q, distances, true = np.arange(21) / 20, arc(x, centre)[..., 0], arc(y, centre)[..., 0]
    if definition == "paper":
        inside = (distances <= true).sum(axis=0)[..., None] <= np.arange(21) * N // 20
    else:
        inside = np.moveaxis(np.quantile(distances, q, axis=0), 0, -1) > true[..., None]
    found = posecal.calibration_curve(x, y, definition=definition, unit="deg").joints
    np.testing.assert_allclose(found, inside.mean(axis=0), atol=1e-12)


@pytest.mark.parametrize("spread", [60.0, 120.0, 1000.0])
@pytest.mark.parametrize("n", [2, 3, 10])
def test_a_perfect_sampler_of_angles_is_calibrated_at_every_n_and_spread(spread: float, n: int) -> None:
    random, poses = np.random.default_rng(n), 20_000
    points = (random.normal(0, spread, (n + 1, poses, 1, 1)) + 180) % 360 - 180
    found = posecal.calibration_curve(points[1:], points[0], unit="deg").joints[0]
    assert (np.abs(found - np.arange(21) / 20) < 4.5 * np.sqrt(0.25 / poses)).all()
    ranks = posecal.evaluate(
        points[1:], points[0], unit="deg", axes="NMKD", metrics="coordinate_pit, interval_width_50"
    )
    assert ranks["coordinate_pit"] < 0.01


def test_the_crps_of_a_compass_by_head() -> None:
    """Errors 0, 90, 180 and 90; four pairs 90 apart and two 180: 90 - 120 / 2."""
    x = np.array([0.0, 90, 180, 270]).reshape(4, 1, 1, 1)
    assert metrics.crps(x, np.zeros((1, 1, 1)), unit="deg") == pytest.approx(30)
    assert metrics.crps(x - 180, np.full((1, 1, 1), 540.0), unit="deg") == pytest.approx(30)


def test_the_energy_score_of_several_angles_is_proper() -> None:
    """Of truths all round two circles no sampler is better than one that is all round too."""
    random = np.random.default_rng(0)
    truth, uniform = random.uniform(-180, 180, (4000, 2, 1)), random.uniform(-180, 180, (20, 4000, 2, 1))
    tied = np.concatenate([uniform[:, :, :1], uniform[:, :, :1] + 180], axis=2)
    pressed = uniform * [[1.0], [0.5]]
    best = metrics.energy_score(uniform, truth, unit="deg").mean()
    assert best < metrics.energy_score(tied, truth, unit="deg").mean()
    assert best < metrics.energy_score(pressed, truth, unit="deg").mean()


def test_the_score_of_a_median_angle_counts_arcs() -> None:
    x = np.array([170.0, -170, 178, -178, 150]).reshape(5, 1, 1, 1)  # 10, 16, 2, 8 and 30 from the others' median
    score = metrics.brier_score(x, np.full((1, 1, 1), -175.0), threshold=15, unit="deg")
    assert score == pytest.approx((0.6 - 1) ** 2 - 0.6 * 0.4 / 4)


def test_steps_of_the_mean_angle_go_the_shorter_way() -> None:
    x = np.array([[170.0, 175, 180], [-175, -170, -165]]).T.reshape(3, 2, 1, 1)  # means 175 and 190
    y = np.array([-179.0, 179]).reshape(2, 1, 1)
    labels = {"sequence": ["a", "a"]}
    report = posecal.evaluate(x, y, unit="deg", axes="NMKD", labels=labels, metrics="mpjve, mean_pose_mpjve")
    assert report["mean_pose_mpjve"] == pytest.approx(17)
    assert report["mpjve"] == pytest.approx(17)


def test_weights_make_a_circular_mean() -> None:
    x, y = np.array([10.0, 100]).reshape(2, 1, 1, 1), np.zeros((1, 1, 1))
    scores = np.array([[3.0], [1.0]])
    report = posecal.evaluate(x, y, unit="deg", axes="NMKD", scores=scores, metrics="weighted_pose_mpjpe", threads=1)
    assert report["weighted_pose_mpjpe"] == pytest.approx(10 + np.degrees(np.arctan2(1, 3)))


@pytest.mark.parametrize(
    ("function", "options", "words"),
    [
        (metrics.mpjpe, {"align": "similarity"}, r"align: similarity; expected none for angles"),
        (metrics.min_mpjpe_curve, {"sizes": [1], "align": "scale"}, r"align: scale; expected none for angles"),
        (metrics.variogram_score, {}, r"unit: deg; expected positions, not angles"),
        (metrics.world_mpjpe, {}, r"unit: deg; expected positions, not angles"),
        (metrics.cps, {}, r"thresholds: 1 to 300 mm, but the data are deg; expected lengths"),
        (metrics.pck, {}, r"threshold: 150 mm, but the data are deg; expected lengths"),
        (metrics.auc, {}, r"thresholds: 0 to 150 mm, but the data are deg; expected lengths"),
        (metrics.brier_score, {}, r"threshold: 150 mm, but the data are deg; expected lengths"),
    ],
)
def test_what_angles_do_not_have_is_refused(function: Any, options: dict[str, Any], words: str) -> None:
    with pytest.raises(PoseDataError, match=words):
        function(*angles(25, 0), unit="deg", **options)


def test_thresholds_in_the_datas_own_unit_are_taken() -> None:
    x, y = angles(25, 0)
    assert metrics.pck(x, y, threshold=20, select="mean", unit="deg") == pytest.approx(
        (arc(x, y) < 20).mean(axis=(0, 2, 3))
    )
    shares = metrics.auc(x, y, thresholds=(0, 90, 91), area="integral", select="mean", unit="deg")
    assert shares == pytest.approx(1 - np.minimum(arc(x, y), 90).mean(axis=(0, 2, 3)) / 90)


@pytest.mark.parametrize("unit", ["px", "none"])
def test_functions_of_arrays_take_pixels_and_numbers_without_a_unit(unit: str) -> None:
    x, y = angles(25, 0)
    np.testing.assert_array_equal(metrics.crps(x, y, unit=unit), metrics.crps(x, y, unit="mm"))


def test_a_function_of_posecal_inside_an_own_metric_knows_that_the_data_are_angles() -> None:
    x, y = angles(*SPREADS["opposite"])

    def widest(hypotheses: Array, truth: Array) -> Array:
        """Largest error."""
        return metrics.mpjpe(hypotheses, truth, of="worst")

    posecal.register(posecal.Metric.from_function(widest, unit="deg"))
    try:
        report = posecal.evaluate(x, y, unit="deg", axes="NMKD", metrics="widest", threads=1)
    finally:
        posecal.unregister("widest")
    assert report["widest"] == pytest.approx(arc(x, y).mean(axis=(2, 3)).max(axis=0).mean())


def test_rates_of_angles_are_no_angles() -> None:
    """Steps of +100° and -100° differ by 200°, and not by the 160° that are left to a full turn."""
    x, y = np.array([0.0, 100, 0, 100]).reshape(1, 4, 1, 1), np.zeros((4, 1, 1))
    for turned in (x, (x + 170) % 360 - 180):
        y = np.full((4, 1, 1), turned[0, 0, 0, 0])
        np.testing.assert_allclose(metrics.acceleration_error(turned, y, unit="deg"), [np.nan, np.nan, 200, 200])
        np.testing.assert_allclose(metrics.jitter(turned, y, unit="deg"), [np.nan, np.nan, np.nan, 400])


@pytest.mark.parametrize("directions", [3, 4, 5, 6, 8])
@pytest.mark.parametrize("turned", [0.0, 17.3])
def test_coverage_is_exact_for_angles_of_few_directions(directions: int, turned: float) -> None:
    """Of all ways to put four points on as many directions, each as the truth in turn: many cancel, or tie."""
    points = np.array([*itertools.product(range(directions), repeat=4)]) * (360 / directions) + turned
    x, y = points[:, 1:].T.reshape(3, -1, 1, 1), points[:, 0].reshape(-1, 1, 1)
    curve = posecal.calibration_curve(x, y, axes="NMKD", unit="deg")
    np.testing.assert_allclose(curve.joints[0], np.arange(21) / 20, atol=1e-9)
    assert interval_coverage(x, y, level=0.4, axes="NMKD", unit="deg").mean() == pytest.approx(0.4, abs=1e-9)


@pytest.mark.parametrize("convention", CONVENTIONS)
def test_a_users_prerank_gets_angles_within_half_a_turn_of_0_however_they_are_written(convention: str) -> None:
    """So a perfect sampler of angles about 180° passes one that depends on the cut of the circle."""
    random, write = np.random.default_rng(3), CONVENTIONS[convention]
    x, y = (180 + random.normal(0, 30, shape) for shape in ((9, 600, 1, 1), (600, 1, 1)))
    options: dict[str, Any] = {"axes": "NMKD", "unit": "deg", "labels": {"sequence": np.arange(600) // 20}}
    preranks = {"size": lambda poses: np.abs(poses).max(axis=(1, 2))}
    report = posecal.evaluate(write(x), write(y), metrics="size", preranks=preranks, **options)
    assert report.test("size").p > 0.05
    plain = posecal.evaluate(
        arc(x, 0 * x), arc(y, 0 * y), metrics="size", preranks=preranks, **{**options, "unit": "none"}
    )
    assert report["size"] == pytest.approx(plain["size"], abs=1e-12)
