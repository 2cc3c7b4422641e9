"""Are poses kept apart by what they are, and by nothing else?"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest

from posecal.data.pose_data import PoseData
from posecal.engine.cells import RUNS, Cells, cells_of, label_name
from posecal.errors import PoseDataError
from tests.helpers.random_worlds import world

Spread = npt.NDArray[np.floating]

M = 20


def pairs_with(**labels: Sequence[object]) -> PoseData:
    """Poses with these labels and no others."""
    return world(M=M).pairs.replace(labels={name: np.array(values).astype(str) for name, values in labels.items()})


def never() -> Spread:
    raise AssertionError("nobody asked for the spread")


def rows(cells: Cells) -> list[tuple[str, ...]]:
    """The labels of each pose's cell."""
    return [tuple(values[cell] for values in cells.labels.values()) for cell in cells.of_pose]


def test_a_cell_is_a_sequence() -> None:
    sequence = ["b"] * 7 + ["a"] * 9 + ["b"] * 4
    cells = cells_of(pairs_with(sequence=sequence), (), never)
    assert cells.labels["sequence"].tolist() == ["b", "a"]
    assert cells.of_pose.tolist() == [0] * 7 + [1] * 9 + [0] * 4
    assert cells.labelled


def test_labels_that_do_not_split_a_sequence_are_kept() -> None:
    sequence, action, camera = ["a", "b"] * 10, ["sit", "walk"] * 10, [1] * 19 + [2]
    cells = cells_of(pairs_with(sequence=sequence, action=action, camera=camera), (), never)
    assert set(cells.labels) == {"sequence", "action"}
    assert rows(cells) == list(zip(sequence, action, strict=True))


def test_labels_that_split_a_sequence_are_kept_where_they_are_asked_for() -> None:
    sequence, camera = ["a"] * 12 + ["b"] * 8, [1, 2] * 10
    cells = cells_of(pairs_with(sequence=sequence, camera=camera), ["camera"], never)
    assert rows(cells) == [(s, str(c)) for s, c in zip(sequence, camera, strict=True)]
    assert len(cells.labels["sequence"]) == 4


def test_without_sequences_poses_are_kept_in_runs_of_consecutive_frames() -> None:
    pairs = pairs_with(action=["sit"] * 5 + ["walk"] * 15)
    cells = cells_of(pairs, ["action"], never)
    assert not cells.labelled
    assert rows(cells) == [(str(m), "sit" if m < 5 else "walk") for m in range(M)]


def test_there_are_at_most_so_many_runs_and_they_are_about_as_long() -> None:
    pairs = world(M=457).pairs.replace(labels={})
    cells = cells_of(pairs, (), never)
    lengths = np.bincount(cells.of_pose)
    assert len(lengths) == RUNS
    assert set(lengths) == {4, 5}
    assert (np.diff(cells.of_pose) >= 0).all()


def test_of_unlabelled_runs_no_other_label_is_kept_unasked() -> None:
    assert set(cells_of(pairs_with(action=["sit"] * M), (), never).labels) == {"sequence"}


# --- by predicted spread ---------------------------------------------------------------------------------------------


def spread() -> Spread:
    """1 … 20 mm, shuffled."""
    return np.random.default_rng(0).permutation(np.arange(1.0, M + 1))


def parts(by: str, values: Callable[[], Spread] = spread) -> list[str]:
    cells = cells_of(pairs_with(sequence=["a"] * M), [by], values)
    return [row[list(cells.labels).index(label_name(by))] for row in rows(cells)]


def test_spread_makes_terciles() -> None:
    # The terciles of 1 … 20 lie at 1 + 19/3 = 7.33 and 1 + 38/3 = 13.67.
    names = ["1: below 7.3 mm", "2: 7.3 to 13.7 mm", "3: above 13.7 mm"]
    assert parts("spread") == [names[int(v > 7.33) + int(v > 13.67)] for v in spread()]


def test_spread_makes_as_many_equal_parts_as_are_asked_for() -> None:
    found = parts("spread:4")
    assert [found.count(name) for name in sorted(set(found))] == [5, 5, 5, 5]


def test_spread_is_cut_where_it_is_told_to_be_in_any_order() -> None:
    expected = [
        "1: below 3.0 mm" if v < 3 else "2: 3.0 to 12.5 mm" if v < 12.5 else "3: above 12.5 mm" for v in spread()
    ]
    assert parts("spread=12.5,3") == expected


def test_two_cuts_of_the_spread_are_kept_beside_each_other() -> None:
    cells = cells_of(pairs_with(sequence=["a"] * M), ["spread:2", "spread=3"], spread)
    # The median of 1 … 20 is 10.5.
    below = [("a", f"{1 + (v > 10.5)}", f"{1 + (v >= 3)}") for v in spread()]
    assert list(cells.labels) == ["sequence", "spread:2", "spread:3"]
    assert [(row[0], row[1][0], row[2][0]) for row in rows(cells)] == below


def test_poses_in_which_no_joint_counts_do_not_move_the_cuts() -> None:
    values = spread()
    values[values > 14] = np.nan
    # The terciles of 1 … 14 lie at 1 + 13/3 = 5.33 and 1 + 26/3 = 9.67.
    names = ["1: below 5.3 mm", "2: 5.3 to 9.7 mm", "3: above 9.7 mm"]
    assert parts("spread", lambda: values) == [
        names[2 if np.isnan(v) else int(v > 5.33) + int(v > 9.67)] for v in values
    ]


def test_without_any_spread_there_are_no_parts() -> None:
    with pytest.raises(PoseDataError, match=r"by: 'spread:2' needs a spread; expected at least 2 hypotheses"):
        parts("spread:2", lambda: np.full(M, np.nan))


def test_a_label_that_is_called_spread_is_taken_as_it_is() -> None:
    cells = cells_of(pairs_with(sequence=["a"] * M, spread=["wide", "thin"] * 10), ["spread"], never)
    assert cells.labels["spread"].tolist() == ["wide", "thin"]


@pytest.mark.parametrize(
    ("entry", "name"),
    [
        ("spread", "spread"),
        ("spread:5", "spread:5"),
        ("spread=40,60", "spread:40,60"),
        ("action", "action"),
        ("spreads", "spreads"),
        ("a=b", "a=b"),
    ],
)
def test_an_entry_names_a_label(entry: str, name: str) -> None:
    assert label_name(entry) == name


@pytest.mark.parametrize(
    "by", ["spread:1", "spread:0", "spread:few", "spread=", "spread=a,b", "spread=nan", "spread=40,inf", "spread:1.5"]
)
def test_parts_that_make_no_sense_are_refused(by: str) -> None:
    with pytest.raises(PoseDataError, match=r"by: .*; expected spread, spread:5 \(equal parts\) or spread=40,60"):
        parts(by)


def test_a_label_that_the_poses_lack_is_refused_with_the_nearest() -> None:
    with pytest.raises(PoseDataError, match=r"by: 'acton' is not a label of these poses\. Did you mean action\?"):
        cells_of(pairs_with(sequence=["a"] * M, action=["sit"] * M), ["acton"], never)


def test_an_average_over_parts_of_the_spread_is_refused_also_beside_groups_of_them() -> None:
    for by in ([], ["spread"]):
        with pytest.raises(PoseDataError, match=r"^average: 'spread' is not a label of these poses\."):
            cells_of(pairs_with(), by, lambda: np.arange(float(M)), average="spread")
