"""Wrong arguments of any function of arrays are refused by posecal's own errors, which name the argument."""

from __future__ import annotations

import inspect

import numpy as np
import pytest

import posecal
from posecal import calibration, metrics
from posecal.errors import PoseDataError
from tests.helpers.random_worlds import skewed

N, M, K = 3, 5, 4
X, Y = skewed(0, N, M, K)

OF_DENSITIES = {"nll", "climatology_log_prob"}  # see tests/metrics/test_likelihood.py
FUNCTIONS = {
    **{name: getattr(metrics, name) for name in metrics.__all__ if name not in OF_DENSITIES},
    "ece": posecal.ece,
    "interval_coverage": calibration.interval_coverage,
    "interval_width": calibration.interval_width,
    "calibration_curve": posecal.calibration_curve,
}
OF_ARRAYS = {name for name, function in FUNCTIONS.items() if "hypotheses" in inspect.signature(function).parameters}
OF_ERRORS = set(FUNCTIONS) - OF_ARRAYS
REQUIRED = {
    "min_mpjpe_curve": {"sizes": [1, 2]},
    **{key: {"observed": np.zeros((1, K, 3))} for key in ("mmade", "mmfde", "apde")},
}

NO_ARRAYS = {
    "text": "hypotheses",
    "none": None,
    "a number": 3.0,
    "complex": X * 1j,
    "words": np.array([["a", "b"]]),
    "objects": np.array([None, 1.0]),
    "ragged": [[1.0, 2.0], [3.0]],
    "too few axes": np.zeros((2, 3)),
    "too many axes": np.zeros((2, 3, 4, 5, 6)),
    "nothing": np.zeros((0, M, K, 3)),
    "yes and no": X > 0,
    "a set": {1.0, 2.0},
}
NO_NAME = (None, 3, "other", ["mean"], np.array(["mean", "min"]), np.zeros(3))
NO_NUMBER = (None, "a", True, 1j, [1.0], np.zeros(2), float("nan"))
WRONG = {
    "align": NO_NAME,
    "of": NO_NAME,
    "select": NO_NAME,
    "definition": NO_NAME,
    "over": NO_NAME,
    "threshold": (*NO_NUMBER, 0, -1.0, float("inf")),
    "share": (*NO_NUMBER, 0, -0.5, 1.5),
    "level": (*NO_NUMBER, 0, 1, -0.5, 90),
    "fps": (*NO_NUMBER[1:], 0, -25.0, float("inf")),
    "sizes": (None, "a", 3, [1.5], [0], [N + 1], [[1]], [True], [1, [2]]),
    "sequence": ("abc", 3, ["a"], [["a"] * M], ["a", ["b", "c"], "d", "e", "f"]),
    "clip": ("abc", 3, ["a"], [["a"] * M], ["a", ["b", "c"], "d", "e", "f"]),
    "observed": (None, "a", 3.0, np.zeros((2, K, 3)), np.zeros((1, K + 1, 3)), np.full((1, K, 3), np.nan)),
    "segment": (*NO_NUMBER[1:], 0, 1, 2.5, float("inf")),
    "area": ("mean", 3, None),
    "thresholds": (150, (0, 150), (50, 0, 10), (0, 50, 1), (0, 50, 2.5), "0:50:10"),
    "where": ("yes", 3, np.full((M, K), 2), np.ones((M, K + 1), bool), [[True], [True, False]]),
    "weights": ("yes", 0.5, np.ones((N, M)), np.ones((N, M + 1)) / N, -np.ones((N, M)) / N, np.full((N, M), np.nan)),
    "axes": ("MNK", 3, "NMKDD", ["NMKD"]),
    "unit": ("inch", 0, -1.0, [1]),
    "root": ("Hip", 1.5, True, K, -K - 1, [0], np.zeros(2), 1j),
}


@pytest.mark.parametrize("wrong", NO_ARRAYS)
@pytest.mark.parametrize("name", sorted(OF_ARRAYS))
def test_what_is_no_array_of_poses_is_refused(name: str, wrong: str) -> None:
    options = REQUIRED.get(name, {})
    with pytest.raises(PoseDataError, match=r"^hypotheses"):
        FUNCTIONS[name](NO_ARRAYS[wrong], Y, **options)
    with pytest.raises(PoseDataError, match=r"truth"):
        FUNCTIONS[name](X, NO_ARRAYS[wrong], **options)


@pytest.mark.parametrize(
    ("name", "option"),
    [
        (name, option)
        for name in sorted(OF_ARRAYS)
        for option in inspect.signature(FUNCTIONS[name]).parameters
        if option in WRONG
    ],
)
def test_a_wrong_option_is_refused(name: str, option: str) -> None:
    for value in WRONG[option]:
        with pytest.raises(PoseDataError, match=rf"^(hypotheses.*)?{option}"):
            FUNCTIONS[name](X, Y, **{**REQUIRED.get(name, {}), option: value})


@pytest.mark.parametrize(
    ("option", "value"), [("threshold", 1e-3), ("threshold", 1e6), ("share", 1e-3), ("share", 1), ("fps", 0.5)]
)
def test_an_option_is_taken_up_to_its_limits(option: str, value: float) -> None:
    takers = [name for name in sorted(OF_ARRAYS) if option in inspect.signature(FUNCTIONS[name]).parameters]
    assert takers
    for name in takers:
        options = {**REQUIRED.get(name, {}), option: value}
        assert np.isfinite(FUNCTIONS[name](X, Y, **options)[3:]).all()  # no motion of the first poses


@pytest.mark.parametrize("mode", [N, -N - 1, "0", None, 1.0, True])
def test_a_wrong_index_of_the_mode_is_refused(mode: object) -> None:
    with pytest.raises(PoseDataError, match=rf"^mode: .*; expected the index of one of {N} hypotheses\."):
        metrics.mpjpe(X, Y, of="mode", mode=mode)  # type: ignore[arg-type]


def test_every_option_of_every_function_is_tried() -> None:
    options = {option for name in OF_ARRAYS for option in inspect.signature(FUNCTIONS[name]).parameters}
    assert options - set(WRONG) == {"hypotheses", "truth", "mode", "population", "strict"}


@pytest.mark.parametrize("wrong", sorted(set(NO_ARRAYS) - {"nothing"}))
@pytest.mark.parametrize("name", sorted(OF_ERRORS))
def test_what_is_no_spread_or_error_of_poses_is_refused(name: str, wrong: str) -> None:
    with pytest.raises(PoseDataError, match=r"^spread"):
        FUNCTIONS[name](NO_ARRAYS[wrong], [1.0, 2.0])
    with pytest.raises(PoseDataError, match=r"error"):
        FUNCTIONS[name]([1.0, 2.0], NO_ARRAYS[wrong])


@pytest.mark.parametrize("option", ["n_hypotheses", "n_poses", "n_joints", "draws"])
@pytest.mark.parametrize("value", [None, "a", True, 0, -1, 2.5, 1j, [3], float("nan"), float("inf")])
def test_a_perfect_sampler_has_whole_numbers(option: str, value: object) -> None:
    with pytest.raises(PoseDataError, match=rf"^{option}: .*; expected a whole number of at least [12]\."):
        calibration.perfect_sampler(**{"n_hypotheses": 5, "n_poses": 9, "n_joints": 2, option: value})


@pytest.mark.parametrize("value", NO_NAME)
def test_a_perfect_sampler_has_a_known_definition_and_summary(value: object) -> None:
    for option in ("definition", "over"):
        with pytest.raises(PoseDataError, match=rf"^{option}: .* is not known\."):
            calibration.perfect_sampler(5, 9, 2, **{option: value})  # type: ignore[arg-type]
    with pytest.raises(PoseDataError, match=r"^definition: .* is not known\."):
        calibration.expected_curve(5, value)  # type: ignore[arg-type]
