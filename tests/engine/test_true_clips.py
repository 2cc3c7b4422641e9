"""Sets of true clips hold whole clips alone, and are told apart by their hash."""

from __future__ import annotations

import numpy as np
import pytest

from posecal import PoseData
from posecal.engine.true_clips import true_clips
from posecal.errors import PoseDataError

RANDOM = np.random.default_rng(1)
TRUTH = RANDOM.normal(0, 100, (4, 3, 5, 3))
OBSERVED = np.zeros((4, 5, 3))
OBSERVED[:, 1, 0] = [0.0, 30.0, 60.0, 300.0]
ALL = np.ones(5, dtype=bool)


def data(**options: object) -> PoseData:
    return PoseData(
        TRUTH[None] + 1, TRUTH, axes="NMTKD", unit="mm", root_joint="none", **{"observed": OBSERVED, **options}
    )  # type: ignore[arg-type]


def test_a_set_holds_the_clips_whose_observed_poses_are_nearer_than_the_threshold() -> None:
    clips = true_clips(data())
    assert clips is not None
    for clip, expected in (("0", [0, 1]), ("1", [0, 1, 2]), ("2", [1, 2]), ("3", [3])):
        found = clips.of(clip, TRUTH[int(clip)], 31.0, ALL)
        assert found is not None
        np.testing.assert_array_equal(found, TRUTH[expected])
    at_threshold = clips.of("0", TRUTH[0], 30.0, ALL)
    assert at_threshold is not None
    assert len(at_threshold) == 1  # strictly nearer, as in the published code


def test_joints_that_are_not_scored_don_t_part_clips() -> None:
    clips = true_clips(data())
    assert clips is not None
    found = clips.of("3", TRUTH[3], 1.0, np.arange(5) != 1)
    assert found is not None
    assert len(found) == 4


def test_a_clip_that_lacks_a_joint_is_in_no_set() -> None:
    where = np.ones((12, 5), dtype=bool)
    where[4, 2] = False  # clip 1
    clips = true_clips(data(where=where))
    assert clips is not None
    assert clips.of("1", TRUTH[1], 1e6, ALL) is None
    found = clips.of("0", TRUTH[0], 1e6, ALL)
    assert found is not None
    np.testing.assert_array_equal(found, TRUTH[[0, 2, 3]])


def test_without_observed_poses_there_are_none() -> None:
    assert true_clips(data(observed=None)) is None


def test_the_hash_is_of_poses_and_of_observed_poses() -> None:
    moved = OBSERVED.copy()
    moved[0, 0, 0] = 1
    hashes = [getattr(true_clips(some), "hash", "") for some in (data(), data(), data(observed=moved))]
    assert hashes[0] == hashes[1] != hashes[2]


def test_another_clip_of_a_name_and_an_unknown_one_are_refused() -> None:
    clips = true_clips(data())
    assert clips is not None
    with pytest.raises(PoseDataError, match=r"^clip: '0' has other true poses than the one that was prepared\."):
        clips.of("0", TRUTH[1], 31.0, ALL)
    with pytest.raises(PoseDataError, match=r"^clip: 'walk' is not among the 4 that were prepared\."):
        clips.of("walk", TRUTH[1], 31.0, ALL)
