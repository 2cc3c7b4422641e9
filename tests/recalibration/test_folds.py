"""Folds are of whole sequences, and alike in poses."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from posecal.errors import PoseDataError
from posecal.recalibration.folds import folds_of
from tests.helpers.random_worlds import skewed
from tests.helpers.samplers import pairs_of


def test_parts_cut_between_sequences_and_are_alike_in_poses() -> None:
    sizes = [9, 1, 4, 4, 3, 2, 7]
    labels = np.repeat([f"s{number}" for number in range(7)], sizes)
    x, y = skewed(13, 2, len(labels), 2)
    part = folds_of(pairs_of(x, y, labels={"sequence": labels}), 3)
    assert all(len(set(part[labels == name])) == 1 for name in set(labels))
    assert sorted(np.bincount(part)) == [10, 10, 10]  # 9 + 1, 7 + 3, 4 + 4 + 2


def test_without_sequences_parts_are_runs_of_frames() -> None:
    np.testing.assert_array_equal(folds_of(pairs_of(*skewed(14, 2, 7, 2)), 3), [0, 0, 0, 1, 1, 2, 2])


@pytest.mark.parametrize(
    ("folds", "labels", "words"),
    [
        (4, ["a", "a", "b", "b", "c"], r"folds: 4; expected 2 to 3, the number of sequences of truth"),
        (1, ["a", "a", "b", "b", "c"], r"folds: 1; expected 2 to 3"),
        (6, None, r"folds: 6; expected 2 to 5, the number of poses of truth"),
        (1, None, r"folds: 1; expected 2 to 5"),
        ("two", None, r"folds: 'two'; expected 2 to 5"),
        (2.5, None, r"folds: 2\.5; expected 2 to 5"),
        (2.0, None, r"folds: 2\.0; expected 2 to 5"),
    ],
)
def test_other_numbers_of_parts_are_refused(folds: Any, labels: list[str] | None, words: str) -> None:
    pairs = pairs_of(*skewed(15, 2, 5, 2), labels=None if labels is None else {"sequence": labels})
    with pytest.raises(PoseDataError, match=words):
        folds_of(pairs, folds)
