"""What public functions take: arrays, files or pose data, and the options that describe them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from posecal.data.pose_data import PoseData
from posecal.errors import PoseDataError
from posecal.evaluation.sources import DESCRIPTIONS, as_pose_data, check_descriptions

X, Y = np.random.default_rng(0).normal(0, 300, (2, 7, 4, 3)), np.zeros((7, 4, 3))
HOW: dict[str, Any] = {"unit": "mm", "axes": "NMKD"}


def test_the_options_that_describe_data_are_those_of_pose_data() -> None:
    assert {"unit", "axes", "labels", "where", "missing", "n_hypotheses"} <= set(DESCRIPTIONS)
    assert not {"hypotheses", "truth", "metrics", "by"} & set(DESCRIPTIONS)
    check_descriptions(dict.fromkeys(DESCRIPTIONS))
    with pytest.raises(PoseDataError, match=r"^option: 'axs' is not known\. Did you mean axes\?"):
        check_descriptions({"units": 1, "axs": 2})
    with pytest.raises(PoseDataError, match=r"^option: 'units' is not known\. Did you mean unit\?"):
        as_pose_data(X, Y, {"units": "mm"})


def test_arrays_are_read_as_the_options_say(tmp_path: Path) -> None:
    found = as_pose_data(X.swapaxes(0, 1), Y, {**HOW, "axes": "MNKD", "n_hypotheses": 1, "where": None})
    assert found.shape == (1, 7, 4, 3)
    np.testing.assert_allclose(found.hypotheses.read(0, 7), X[:1])
    for name, array in (("x", X), ("y", Y)):
        np.save(tmp_path / f"{name}.npy", array)
    of_files = as_pose_data(tmp_path / "x.npy", str(tmp_path / "y.npy"), HOW)
    np.testing.assert_array_equal(of_files.hypotheses.read(0, 7), X)
    assert of_files.names == ("x.npy", "y.npy")


def test_pose_data_stay_as_they_are() -> None:
    data = PoseData(X, Y, **HOW)
    for options in ({}, {"unit": None, "where": None}, {"missing": "error", "shared_joints": "same"}):
        assert as_pose_data(data, None, options) is data


@pytest.mark.parametrize(
    ("truth", "options", "what"),
    [
        (Y, {}, "truth"),
        (None, {"fps": None, "unit": "mm"}, "unit"),
        (Y, {"unit": "mm"}, "truth"),
        (None, {"missing": "skip"}, "missing"),
        (None, {"labels": {"missing": "error"}}, "labels"),
    ],
)
def test_nothing_stands_beside_pose_data(truth: Any, options: dict[str, Any], what: str) -> None:
    words = rf"^{what}: given beside PoseData, which holds it already; expected PoseData alone\.$"
    with pytest.raises(PoseDataError, match=words):
        as_pose_data(PoseData(X, Y, **HOW), truth, options)


def test_hypotheses_need_a_truth() -> None:
    with pytest.raises(PoseDataError, match=r"^truth: missing; expected true poses \(M, K, D\) after the hypotheses"):
        as_pose_data(X, None, {})
