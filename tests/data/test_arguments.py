"""Two arrays as functions of arrays take them: layouts and units that can't be told are refused, or declared."""

from __future__ import annotations

import re

import numpy as np
import pytest

import posecal
from posecal import metrics
from posecal.data.arguments import checked
from posecal.engine.block import Block
from posecal.errors import PoseDataError
from tests.helpers.random_worlds import skewed

OF_PAIRS = {"rank_correlation", "sparsification", "ause", "risk_coverage", "aurc", "excess_aurc", "failure_auroc"}
OF_DENSITIES = {"nll", "climatology_log_prob"}
FUNCTIONS = sorted({*metrics.__all__} - OF_PAIRS - OF_DENSITIES)
REQUIRED = {"min_mpjpe_curve": {"sizes": [1, 2]}}
REQUIRED |= {key: {"observed": skewed(3, 1, 1, 4)[1]} for key in ("mmade", "mmfde", "apde")}
X, Y = skewed(3, 6, 6, 4)


def call(name: str, x: object, y: object, **options: object) -> object:
    function = getattr(posecal, name) if name in ("ece", "calibration_curve") else getattr(metrics, name)
    return function(x, y, **REQUIRED.get(name, {}), **options)


@pytest.mark.parametrize("name", [*FUNCTIONS, "ece", "calibration_curve"])
def test_as_many_hypotheses_as_poses_are_refused_until_the_layout_is_declared(name: str) -> None:
    with pytest.raises(PoseDataError, match=r'apart \(N = M = 6\)\. Pass axes="NMKD" or axes="MNKD"\.$'):
        call(name, X, Y)
    with pytest.raises(PoseDataError, match="N = M = 6"):
        call(name, X.swapaxes(0, 1), Y)
    declared, turned = call(name, X, Y, axes="NMKD"), call(name, X.swapaxes(0, 1), Y, axes="MNKD")
    if name == "calibration_curve":
        declared, turned = declared.joints, turned.joints  # type: ignore[attr-defined]
    np.testing.assert_array_equal(declared, turned)


@pytest.mark.parametrize("shape", [(5, 3, 4, 4), (4, 4, 4, 3), (3, 3, 3, 3)])
def test_other_axes_of_equal_length_are_refused_too(shape: tuple[int, ...]) -> None:
    with pytest.raises(PoseDataError, match="tell the axes apart"):
        metrics.min_mpjpe(np.zeros(shape), np.zeros(shape[1:]))


@pytest.mark.parametrize("shape", [(1, 1, 4, 3), (1, 1, 1, 3), (3, 1, 1, 1), (5, 2, 1, 1), (1, 1, 1, 1)])
def test_axes_of_length_one_can_be_exchanged_and_are_taken(shape: tuple[int, ...]) -> None:
    assert metrics.min_mpjpe(np.full(shape, 2.0), np.zeros(shape[1:])).shape == shape[1:2]


def test_coordinates_before_joints_and_flattened_ones_are_turned_with_the_truth_as_it_is() -> None:
    x, y = skewed(4, 5, 7, 4)
    expected = metrics.min_mpjpe(x, y)
    flat = x.swapaxes(0, 1).reshape(7, 5, 12)
    np.testing.assert_array_equal(metrics.min_mpjpe(flat, y, axes="MN(KD)"), expected)
    np.testing.assert_array_equal(metrics.min_mpjpe(x.swapaxes(2, 3), y, axes="NMDK"), expected)


def test_a_mask_goes_with_the_turned_poses() -> None:
    x, y = skewed(5, 5, 7, 4)
    where = np.arange(28).reshape(7, 4) % 3 > 0
    np.testing.assert_array_equal(
        metrics.mpjpe(x.swapaxes(0, 1), y, where=where, axes="MNKD"), metrics.mpjpe(x, y, where=where)
    )


@pytest.mark.parametrize("name", FUNCTIONS)
def test_metres_are_refused_by_every_function_in_millimetres_until_they_are_declared(name: str) -> None:
    x, y = skewed(6, 5, 7, 4)
    with pytest.raises(PoseDataError, match=r'^truth looks like metres: .* Pass unit="m", or unit="mm" if'):
        call(name, x / 1000, y / 1000)
    np.testing.assert_allclose(np.asarray(call(name, x / 1000, y / 1000, unit="m")), call(name, x, y), rtol=1e-9)


def test_declared_millimetres_are_measured_however_small() -> None:
    x, y = skewed(6, 5, 7, 4)
    np.testing.assert_allclose(metrics.min_mpjpe(x / 1000, y / 1000, unit="mm"), metrics.min_mpjpe(x, y) / 1000)


def test_calibration_has_no_unit() -> None:
    x, y = skewed(6, 5, 7, 4)
    assert posecal.ece(x / 1024, y / 1024) == posecal.ece(x, y)


def test_two_units_are_refused() -> None:
    x, y = skewed(6, 5, 7, 4)
    with pytest.raises(
        PoseDataError, match=r"^hypotheses and truth differ in size by a factor of \d{3,}; expected one"
    ):
        metrics.pck(x / 1000, y)


def test_integers_are_taken_as_double() -> None:
    x, y, _ = checked(np.full((2, 3, 1, 3), 7), np.zeros((3, 1, 3), dtype=np.int16))
    assert x.dtype == y.dtype == np.float64
    assert x[0, 0, 0].tolist() == [7, 7, 7]


def test_a_metric_of_the_user_s_own_gets_blocks_of_declared_poses_whatever_their_length_and_size() -> None:
    def upper(hypotheses: np.ndarray, truth: np.ndarray) -> np.ndarray:
        return metrics.min_mpjpe(hypotheses[:, :, 2:], truth[:, 2:])

    for x, y, unit in ((X, Y, "mm"), (X / 1000, Y / 1000, "mm")):  # N = M, and tiny by declaration
        values = posecal.Metric.from_function(upper).statistic.compute(Block(x, y))
        np.testing.assert_allclose(values, upper_of(x, y, unit), rtol=1e-9)
    with pytest.raises(PoseDataError, match="N = M = 6"):  # and only those
        metrics.min_mpjpe(X, Y)


def upper_of(x: np.ndarray, y: np.ndarray, unit: str) -> np.ndarray:
    return metrics.min_mpjpe(x[:, :, 2:], y[:, 2:], axes="NMKD", unit=unit)


def test_what_arrays_alone_can_show_is_answered_with_what_to_do() -> None:
    random = np.random.default_rng(0)
    y = random.normal(0, 300, (9, 6, 3))
    x = y + random.normal(0, 40, (4, 9, 6, 3))
    four = [np.concatenate([poses, np.full((*poses.shape[:-1], 1), 0.5)], axis=-1) for poses in (x, y)]
    for hypotheses, truth, words in (
        (*four, "D = 4; expected at most 3 coordinates of a position, last. Leave out a confidence"),
        (x.swapaxes(2, 3), y.swapaxes(1, 2), "D = 6; expected at most 3 coordinates of a position, last."),
        (x[0], y, "Of one prediction of each pose pass hypotheses[None]."),
        (x.swapaxes(0, 1), y, 'M is 4 and 9. The shapes fit axes="MNKD".'),
    ):
        with pytest.raises(PoseDataError, match=re.escape(words)):
            metrics.mpjpe(hypotheses, truth)
