"""Pose data of several sources read as one array would be."""

from __future__ import annotations

import numpy as np
import pytest

from posecal.data.joined import join_poses
from posecal.engine.prepare import select_scored
from posecal.engine.protocol import Protocol
from posecal.stats.skill import climatology, with_reference
from tests.helpers.sharded import frames

WORLD = frames(M=30, S=3)
ROWS = [np.array([20, 3, 4]), np.array([0]), np.array([5, 29, 28, 1])]


def test_poses_of_several_sources_come_one_after_another() -> None:
    joined, rows = join_poses([WORLD.data(some, has_names=False) for some in ROWS]), np.concatenate(ROWS)
    assert joined.shape == (6, 8, 7, 3)
    np.testing.assert_array_equal(joined.truth, WORLD.truth[rows])
    np.testing.assert_array_equal(joined.hypotheses.read(0, 8), WORLD.hypotheses[:, rows])
    np.testing.assert_array_equal(joined.hypotheses.read(2, 6), WORLD.hypotheses[:, rows[2:6]])
    assert joined.frame_id.tolist() == ["0", "1", "2", "0", "0", "1", "2", "3"]
    assert joined.labels["sequence"].tolist() == WORLD.sequence[rows].tolist()
    mixed = np.array([7, 0, 3, 2, 6])
    np.testing.assert_array_equal(joined.select(mixed).hypotheses.read(1, 5), WORLD.hypotheses[:, rows[mixed[1:]]])


def test_one_source_is_itself() -> None:
    data = WORLD.data()
    assert join_poses([data]) is data


def test_members_that_some_lack_are_what_stands_for_them() -> None:
    random = np.random.default_rng(0)
    where = random.random((30, 7)) < 0.7
    where[:, 0] = True
    weights = random.dirichlet(np.ones(6), 30).T
    first, second = WORLD.data(slice(0, 10), where=where[:10], weights=weights[:, :10]), WORLD.data(slice(10, 30))
    joined = join_poses([first, second])
    assert joined.where is not None
    np.testing.assert_array_equal(joined.where, np.concatenate([where[:10], np.ones((20, 7), dtype=bool)]))
    np.testing.assert_allclose(joined.weights, np.concatenate([weights[:, :10], np.full((6, 20), 1 / 6)], axis=1))
    assert join_poses([second, second]).where is None
    occluded = random.random((30, 7)) < 0.5
    parts = [
        select_scored(WORLD.data(some, occluded=occluded[some], **more), Protocol(where="visible"))
        for some, more in ((slice(0, 10), {"where": where[:10]}), (slice(10, 30), {}))
    ]
    np.testing.assert_array_equal(join_poses(parts).usable, np.concatenate([where[:10], np.ones((20, 7), dtype=bool)]))


@pytest.mark.parametrize("n", [4, 6])
def test_climatology_of_parts_is_that_of_the_whole(n: int) -> None:
    whole = WORLD.data()
    reference = climatology(whole, n)
    parts = [with_reference(whole, reference).select(some) for some in ROWS]
    joined = join_poses(parts).reference
    assert joined is not None
    expected = reference.hypotheses.read(0, 30)[:, np.concatenate(ROWS)]
    np.testing.assert_array_equal(joined.hypotheses.read(0, 8), expected)
    assert joined.hypotheses.hash == reference.hypotheses.hash  # type: ignore[attr-defined]
