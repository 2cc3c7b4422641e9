"""What depends on all poses, found in parts and put together."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from posecal.engine.prepare import Prepared, prepare
from tests.helpers.sharded import cuts, frames

WORLD = frames(M=96)


@pytest.mark.parametrize("cut", cuts(M=96))
def test_parts_that_are_joined_are_the_whole(cut: str) -> None:
    whole = prepare(WORLD.data())
    found = Prepared.joined([prepare(WORLD.data(rows)) for rows in cuts(M=96)[cut]])
    assert found.n_poses == 96
    for end in ("least", "largest"):
        np.testing.assert_array_equal(getattr(found.limits, end), getattr(whole.limits, end))
    names = [np.array(sorted(some.sequences, key=lambda name: some.sequences[name])) for some in (found, whole)]
    reached = [names[n][some.limits.reached_by] for n, some in enumerate((found, whole))]
    np.testing.assert_array_equal(*reached)


def test_poses_without_sequences_are_numbered_through_the_parts() -> None:
    found = Prepared.joined([prepare(WORLD.data(rows, labels=None)) for rows in np.split(np.arange(96), [10, 61])])
    whole = prepare(WORLD.data(labels=None))
    assert found.sequences == {}
    for one, other in zip(found.limits, whole.limits, strict=True):
        np.testing.assert_array_equal(one, other)


def test_the_place_of_a_part_is_not_what_it_was_prepared_with() -> None:
    whole = prepare(WORLD.data())
    assert replace(whole, first=7).hash == whole.hash
    assert prepare(WORLD.data(slice(0, 90))).hash != whole.hash
