"""Poses are kept apart by sequence and by labels, and by nothing else, in one piece as in batches."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt
import pytest

from posecal.engine.cells import MAX_RUNS, CellIndex, label_name, spread_cuts, spread_labels
from posecal.errors import PoseDataError
from tests.helpers.random_worlds import world
from tests.helpers.sums import accumulate

Array = npt.NDArray[np.floating]
Labels = Mapping[str, npt.NDArray[np.str_]]

M = 20


def labels_of(**labels: Sequence[object]) -> dict[str, npt.NDArray[np.str_]]:
    return {name: np.array(values).astype(str) for name, values in labels.items()}


def rows_in(labels: Labels, sizes: Sequence[int], *by: str, average: str = "poses") -> list[tuple[str, ...]]:
    """The labels of each pose's cell, for poses that come in batches of these sizes."""
    index = CellIndex(by, average, [*labels])
    cells, start = np.zeros(0, dtype=int), 0
    for size in sizes:
        part = {name: values[start : start + size] for name, values in labels.items()}
        start += size
        more, moved = index.assign(part, size)
        cells = np.concatenate([cells if moved is None else moved[cells], more])
    values = index.cells
    assert sorted(set(cells)) == list(range(len(values["sequence"])))
    return [tuple(column[cell] for column in values.values()) for cell in cells]


def cells_of(labels: Labels, *by: str, n: int = M) -> tuple[dict[str, npt.NDArray[np.str_]], list[int]]:
    """All cells, and the number of each pose's."""
    index = CellIndex(by, "poses", [*labels])
    numbers, moved = index.assign(labels, n)
    assert moved is None
    return index.cells, numbers.tolist()


# --- labels ---------------------------------------------------------------------------------------------------


def test_a_cell_is_a_sequence_in_the_order_of_first_poses() -> None:
    cells, numbers = cells_of(labels_of(sequence=["b"] * 7 + ["a"] * 9 + ["b"] * 4))
    assert cells["sequence"].tolist() == ["b", "a"]
    assert numbers == [0] * 7 + [1] * 9 + [0] * 4


def test_labels_that_do_not_split_a_sequence_are_kept() -> None:
    sequence, action, camera = ["a", "b"] * 10, ["sit", "walk"] * 10, [1] * 19 + [2]
    labels = labels_of(sequence=sequence, action=action, camera=camera)
    assert set(cells_of(labels)[0]) == {"sequence", "action"}
    assert rows_in(labels, [M]) == list(zip(sequence, action, strict=True))


def test_labels_that_split_a_sequence_are_kept_where_they_are_asked_for() -> None:
    sequence, camera = ["a"] * 12 + ["b"] * 8, [1, 2] * 10
    labels = labels_of(sequence=sequence, camera=camera)
    rows = rows_in(labels, [M], "camera")
    assert rows == [(s, str(c)) for s, c in zip(sequence, camera, strict=True)]
    assert len(set(rows)) == 4
    assert rows_in(labels, [M], average="camera") == rows


def test_the_order_of_labels_is_the_one_that_was_asked_for() -> None:
    labels = labels_of(camera=[1, 2] * 10, action=["sit"] * M, sequence=["a"] * M, phase=["x", "y"] * 10)
    assert list(cells_of(labels, "phase", "camera")[0]) == ["sequence", "phase", "camera", "action"]


def test_values_that_join_to_the_same_text_are_different_cells() -> None:
    labels = labels_of(sequence=["a", "ab"] * 10, action=["bc", "c"] * 10)
    assert len(set(rows_in(labels, [M], "action"))) == 2


# --- runs of poses without sequences --------------------------------------------------------------------------


def test_without_sequences_poses_are_kept_in_runs_of_consecutive_poses() -> None:
    labels = labels_of(action=["sit"] * 5 + ["walk"] * 15)
    assert not CellIndex(["action"], "poses", ["action"]).has_sequences
    assert CellIndex([], "poses", ["action", "sequence"]).has_sequences
    assert rows_in(labels, [M], "action") == [(str(m), "sit" if m < 5 else "walk") for m in range(M)]


@pytest.mark.parametrize(("poses", "length"), [(1, 1), (100, 1), (101, 2), (200, 2), (201, 4), (457, 8), (3201, 64)])
def test_runs_are_of_the_smallest_power_of_two_that_leaves_at_most_a_hundred(poses: int, length: int) -> None:
    cells, numbers = cells_of({}, n=poses)
    assert MAX_RUNS == 100
    assert numbers == [pose // length for pose in range(poses)]
    assert cells["sequence"].tolist() == [str(run) for run in range(-(-poses // length))]


def test_with_runs_no_other_label_is_kept_unless_it_is_asked_for() -> None:
    assert set(cells_of(labels_of(action=["sit"] * M))[0]) == {"sequence"}


# --- batches --------------------------------------------------------------------------------------------------

CUTS = [[1] * M, [7, 13], [19, 1], [3, 0, 17]]


@pytest.mark.parametrize("sizes", CUTS)
def test_a_label_that_splits_a_sequence_in_a_later_batch_is_dropped_from_earlier_cells(sizes: list[int]) -> None:
    labels = labels_of(
        sequence=["a"] * 10 + ["b"] * 10,
        action=["sit"] * 10 + ["walk"] * 10,
        camera=[1] * 19 + [2],
        late=[1] * 9 + [2] * 11,
    )
    assert rows_in(labels, sizes) == [("a", "sit")] * 10 + [("b", "walk")] * 10


@pytest.mark.parametrize("sizes", CUTS)
def test_a_label_that_changes_where_a_sequence_goes_on_is_dropped_and_its_cells_are_joined(sizes: list[int]) -> None:
    labels = labels_of(sequence=["a"] * 5 + ["b"] * 5 + ["a"] * 10, take=[1] * 10 + [2] * 10)
    rows = rows_in(labels, sizes)
    assert rows == [("a",)] * 5 + [("b",)] * 5 + [("a",)] * 10


@pytest.mark.parametrize("sizes", [[1] * 457, [100, 357], [99, 1, 1, 1, 355], [456, 1]])
@pytest.mark.parametrize("by", [(), ("action",)])
def test_runs_do_not_depend_on_the_batches(sizes: list[int], by: tuple[str, ...]) -> None:
    labels = labels_of(action=["sit"] * 203 + ["walk"] * 254)
    assert rows_in(labels, sizes, *by) == rows_in(labels, [457], *by)
    assert len({row[0] for row in rows_in(labels, sizes, *by)}) == 58


def test_where_nothing_is_joined_nothing_moves() -> None:
    index = CellIndex([], "poses", ["sequence"])
    assert index.assign(labels_of(sequence=["a"]), 1)[1] is None
    assert index.assign(labels_of(sequence=["b", "a"]), 2)[1] is None
    runs = CellIndex([], "poses", [])
    assert runs.assign({}, 100)[1] is None
    assert runs.assign({}, 1)[1].tolist() == [pose // 2 for pose in range(100)]  # type: ignore[union-attr]


# --- labels that are missing ----------------------------------------------------------------------------------


def test_a_label_that_the_poses_lack_is_refused_with_the_nearest() -> None:
    with pytest.raises(PoseDataError, match=r"^by: 'acton' is not a label of these poses\. Did you mean action\?"):
        CellIndex(["acton"], "poses", ["sequence", "action"])
    with pytest.raises(PoseDataError, match=r"^average: 'acton' is not a label of these poses\. Did you mean action\?"):
        CellIndex([], "acton", ["sequence", "action"])
    with pytest.raises(PoseDataError, match=r"^by: 'x' is not a label of these poses\. Known: predicted_spread\."):
        CellIndex(["x"], "poses", [])


def test_an_average_over_parts_of_the_spread_is_refused_also_beside_groups_of_them() -> None:
    for by in ([], ["predicted_spread"]):
        with pytest.raises(PoseDataError, match=r"^average: 'predicted_spread' is not a label of these poses\."):
            CellIndex(by, "predicted_spread", ["sequence"])


# --- parts by predicted spread --------------------------------------------------------------------------------


def spread() -> Array:
    """1 … 20 mm, shuffled."""
    return np.random.default_rng(0).permutation(np.arange(1.0, M + 1))


def parts(by: str, values: Array) -> list[str]:
    return spread_labels(spread_cuts(by, values), values).tolist()


def test_predicted_spread_makes_terciles() -> None:
    # The terciles of 1 … 20 lie at 1 + 19/3 = 7.33 and 1 + 38/3 = 13.67.
    names = ["1: below 7.3 mm", "2: 7.3 to 13.7 mm", "3: above 13.7 mm"]
    assert parts("predicted_spread", spread()) == [names[int(v > 7.33) + int(v > 13.67)] for v in spread()]


def test_predicted_spread_makes_as_many_equal_parts_as_are_asked_for() -> None:
    made = parts("predicted_spread:4", spread())
    assert [made.count(name) for name in sorted(set(made))] == [5, 5, 5, 5]


def test_predicted_spread_is_cut_at_lengths_in_any_order() -> None:
    expected = [
        "1: below 3.0 mm" if v < 3 else "2: 3.0 to 12.5 mm" if v < 12.5 else "3: above 12.5 mm" for v in spread()
    ]
    assert parts("predicted_spread=12.5,3", spread()) == expected
    np.testing.assert_array_equal(spread_cuts("predicted_spread=12.5,3", None), [3, 12.5])


def test_poses_in_which_no_joint_counts_do_not_move_the_cuts() -> None:
    values = spread()
    values[values > 14] = np.nan
    # The terciles of 1 … 14 lie at 1 + 13/3 = 5.33 and 1 + 26/3 = 9.67.
    names = ["1: below 5.3 mm", "2: 5.3 to 9.7 mm", "3: above 9.7 mm"]
    expected = [names[2 if np.isnan(v) else int(v > 5.33) + int(v > 9.67)] for v in values]
    assert parts("predicted_spread", values) == expected


def test_without_any_spread_there_are_no_parts() -> None:
    with pytest.raises(
        PoseDataError, match=r"by: 'predicted_spread:2' needs a spread; expected at least 2 hypotheses and a joint"
    ):
        spread_cuts("predicted_spread:2", np.full(M, np.nan))


def test_equal_parts_need_all_poses_first() -> None:
    with pytest.raises(PoseDataError, match=r"by: 'predicted_spread' needs all poses before the first batch; expected"):
        spread_cuts("predicted_spread", None)


@pytest.mark.parametrize(
    ("entry", "name"),
    [
        ("predicted_spread", "predicted_spread"),
        ("predicted_spread:5", "predicted_spread:5"),
        ("predicted_spread=40,60", "predicted_spread:40,60"),
        ("action", "action"),
        ("predicted_spreads", "predicted_spreads"),
        ("a=b", "a=b"),
    ],
)
def test_an_entry_names_a_label(entry: str, name: str) -> None:
    assert label_name(entry) == name


@pytest.mark.parametrize("how", [":1", ":0", ":few", "=", "=a,b", "=nan", "=40,inf", ":1.5"])
def test_parts_that_make_no_sense_are_refused(how: str) -> None:
    with pytest.raises(
        PoseDataError,
        match=r"by: .*; expected predicted_spread, predicted_spread:5 \(equal parts\) or predicted_spread=40,60",
    ):
        spread_cuts(f"predicted_spread{how}", spread())


def test_groups_by_predicted_spread_are_cells_beside_each_other() -> None:
    some = world(M=M).pairs
    cells = accumulate(some, by=["predicted_spread:2", "predicted_spread=60"]).cells
    assert list(cells) == ["sequence", "predicted_spread:2", "predicted_spread:60", "action"]
    assert {name[:2] for name in cells["predicted_spread:2"]} == {"1:", "2:"}
    assert set(cells["predicted_spread:60"]) <= {"1: below 60.0 mm", "2: above 60.0 mm"}


def test_a_label_that_is_called_predicted_spread_is_taken_as_it_is() -> None:
    some = world(M=M).pairs
    labels = {**some.labels, "predicted_spread": np.array(["wide", "thin"] * 10)}
    cells = accumulate(some.replace(labels=labels), by=["predicted_spread"]).cells
    assert set(cells["predicted_spread"]) == {"wide", "thin"}
