"""Batches that fail part way, options that stand where labels do, and what batches may lack."""

import pickle
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

import posecal
from posecal.errors import PoseDataError
from posecal.registry import register, unregister
from posecal.stats.skill import with_reference

N, M, K = 7, 60, 5
Arrays = tuple[npt.NDArray[Any], npt.NDArray[Any]]


@pytest.fixture
def arrays() -> Arrays:
    random = np.random.default_rng(3)
    truth = random.normal(0, 300, (M, K, 3))
    return truth + random.normal(0, 50, (N, M, K, 3)), truth


def batch(arrays: Arrays, start: int, stop: int) -> Arrays:
    return arrays[0][:, start:stop], arrays[1][start:stop]


def evaluation(**options: Any) -> posecal.Evaluation:
    return posecal.Evaluation(**{"unit": "mm", "axes": "NMKD", "threads": 1, **options})


# --- what is not finite -----------------------------------------------------------------------------------------


def holed(arrays: Arrays, *places: tuple[int, int], value: float = np.nan) -> Arrays:
    hypotheses = arrays[0].copy()
    for pose, joint in places:
        hypotheses[3, pose, joint, 1] = value
    return hypotheses, arrays[1]


@pytest.mark.parametrize("value", [np.nan, np.inf])
@pytest.mark.parametrize("window", [1, 10**9])
def test_pose_data_that_are_not_finite_are_refused_before_any_is_counted(
    arrays: Arrays, window: int, value: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("posecal.engine.chunks.WINDOW_BYTES", window)
    some, broken = evaluation(), holed(arrays, (41, 2), (55, 4), (55, 1), value=value)
    some.add(posecal.PoseData(*batch(arrays, 0, 30), unit="mm"))
    refused = r"^hypotheses has non-finite coordinates in 2 of 30 frames \(first: frame 11, joint 2\)\. Mask those"
    with pytest.raises(PoseDataError, match=refused):
        some.add(posecal.PoseData(*batch(broken, 30, 60), unit="mm"))
    some.add(posecal.PoseData(*batch(arrays, 30, 60), unit="mm"))
    assert some.compute()["mpjpe"] == pytest.approx(posecal.evaluate(*arrays, unit="mm")["mpjpe"], rel=1e-12)
    assert some.totals().poses.sum() == M


def test_a_reference_that_is_not_finite_is_refused_by_its_name(arrays: Arrays) -> None:
    data, other = (posecal.PoseData(*some, unit="mm") for some in (arrays, holed(arrays, (7, 3))))
    some = evaluation(metrics="scores")
    with pytest.raises(
        PoseDataError, match=r"^other has non-finite coordinates in 1 of 60 frames \(first: frame 7, jo"
    ):
        some.add(with_reference(data, other.replace(names=("other", "truth"))))
    with pytest.raises(
        PoseDataError, match=r"^other has non-finite coordinates in 1 of 60 frames \(first: frame 7, jo"
    ):
        posecal.evaluate(data, reference=other.replace(names=("other", "truth")), metrics="scores")
    some.add(with_reference(data, data.replace(names=("other", "truth"))))
    assert some.compute()["energy_skill"] == pytest.approx(0, abs=1e-12)


@pytest.mark.parametrize("block", [4000, 10**9])
def test_joints_and_frames_that_do_not_count_may_be_anything(
    arrays: Arrays, block: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("posecal.engine.block.BLOCK_BYTES", block)
    places = ((41, 2), (55, 4))
    occluded = np.zeros((M, K), dtype=bool)
    occluded[tuple(np.transpose(places))] = True
    found, expected = evaluation(protocol=posecal.Protocol(where="visible")), evaluation()
    for part in (slice(0, 45), slice(45, 60)):
        truth, masks = arrays[1][part], occluded[part]
        found.update(holed(arrays, *places)[0][:, part], truth, occluded=masks)
        expected.update(arrays[0][:, part], truth, where=~masks)
    assert found.compute()["mpjpe"] == pytest.approx(expected.compute()["mpjpe"], rel=1e-12)
    again = evaluation()
    again.update(*arrays, frame_id=np.arange(M))
    again.update(*holed(arrays, (7, 1)), frame_id=np.arange(M))  # all known
    assert again.totals().poses.sum() == M


# --- failures part way ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("error", [KeyError, KeyboardInterrupt])
def test_after_a_batch_that_failed_part_way_all_is_refused_until_reset(
    arrays: Arrays, monkeypatch: pytest.MonkeyPatch, error: type[BaseException]
) -> None:
    monkeypatch.setattr("posecal.engine.block.BLOCK_BYTES", 4000)  # blocks of a few poses
    calls = {"left": 1000}

    def fragile(hypotheses: npt.NDArray[Any], truth: npt.NDArray[Any]) -> npt.NDArray[Any]:
        calls["left"] -= 1
        if not calls["left"]:
            raise error("broken")
        return np.ones(len(truth))

    register(posecal.Metric.from_function(fragile, definition="one"))
    try:
        some = evaluation()
        some.update(*batch(arrays, 0, 30))
        calls["left"] = 2
        with pytest.raises((error, PoseDataError)):
            some.update(*batch(arrays, 30, 60))
        refused = r"^evaluation: a batch failed part way \(.*broken.*expected reset\(\)"
        for call in (some.compute, lambda: some.update(*batch(arrays, 30, 60)), lambda: evaluation().merge(some)):
            with pytest.raises(PoseDataError, match=refused):
                call()
        with pytest.raises(PoseDataError, match=refused):
            pickle.loads(pickle.dumps(some)).compute()
        some.reset()
        some.update(*arrays)
        assert some.compute().totals.poses.sum() == M
        calls["left"] = 2
        first = evaluation()
        with pytest.raises((error, PoseDataError)):
            first.update(*arrays)
        first.update(*arrays)  # nothing was counted before
        assert first.compute().totals.poses.sum() == M
    finally:
        unregister("fragile")


# --- options that stand where labels do -----------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("unit", r"^update: 'unit' is an option and no label; it belongs to Evaluation\(unit=…\)\.$"),
        ("axes", r"Evaluation\(axes=…\)"),
        ("fps", r"Evaluation\(fps=…\)"),
        ("n_hypotheses", r"Evaluation\(n_hypotheses=…\)"),
        ("align", r"Evaluation\(protocol=Protocol\(align=…\)\)"),
        ("missing", r"evaluate\(missing=…\)"),
        ("progress", r"evaluate\(progress=…\)"),
        ("truth", r"comes first, without its name"),
        ("labels", r"given one by one, such as sequence=…"),
        ("frame_ids", r"^update: 'frame_ids' is no option\. Did you mean frame_id\?$"),
        ("sequnce", r"Did you mean sequence\?"),
        ("occluded_", r"Did you mean occluded\?"),
        ("score", r"Did you mean scores\?"),
    ],
)
def test_an_option_is_not_taken_for_a_label(arrays: Arrays, name: str, message: str) -> None:
    some = evaluation()
    with pytest.raises(PoseDataError, match=message):
        some.update(*arrays, **{name: "m"})


def test_ordinary_labels_pass(arrays: Arrays) -> None:
    some = evaluation()
    names = ("sequence", "action", "subject", "camera", "dataset", "phase", "gender", "scene", "frame")
    some.update(*arrays, **dict.fromkeys(names, "a"))
    assert some.compute().totals.labels == names


def test_frame_ids_are_words_or_whole_numbers(arrays: Arrays) -> None:
    with pytest.raises(PoseDataError, match=r"^frame_id: object \(60,\); expected one word or whole number per pose"):
        evaluation().update(*arrays, frame_id=np.array([None] * M))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"axes": "QQ"}, r"^axes: 'QQ' lacks"),
        ({"unit": "inch"}, r"^unit: 'inch'; expected mm"),
        ({"by": 5}, r"^by: 5; expected names of labels"),
        ({"by": [5]}, r"^by: \[5\]; expected names of labels"),
        ({"preranks": 5}, r"^preranks: 5; expected a mapping from names to callables"),
        ({"preranks": {5: len}}, r"^preranks: .*expected a mapping from names to callables"),
        ({"preranks": {"depth": 5}}, r"^preranks: depth: 5; expected a callable"),
        ({"prepared": 5}, r"^prepared: int; expected what posecal\.prepare gives"),
    ],
)
def test_options_that_cannot_be_are_refused_at_once(options: dict[str, Any], message: str) -> None:
    with pytest.raises(PoseDataError, match=message):
        posecal.Evaluation(**options)


def test_progress_must_be_callable(arrays: Arrays) -> None:
    with pytest.raises(PoseDataError, match=r"^progress: 5; expected a callable"):
        posecal.evaluate(*arrays, unit="mm", axes="NMKD", progress=5)  # type: ignore[arg-type]
    with pytest.raises(PoseDataError, match=r"^progress: 5; expected a callable"):
        posecal.compare({"a": arrays[0], "b": arrays[0]}, arrays[1], progress=5)  # type: ignore[arg-type]


def test_sequences_that_prepared_lacks_are_refused(arrays: Arrays) -> None:
    data = posecal.PoseData(*batch(arrays, 0, 30), unit="mm", axes="NMKD", labels={"sequence": "a"})
    some = evaluation(metrics="rank_tests", prepared=posecal.prepare(data))
    some.update(*batch(arrays, 0, 30), sequence="a")
    with pytest.raises(PoseDataError, match=r"^sequence: b not in prepared; expected it to be made with the true"):
        some.update(*batch(arrays, 30, 60), sequence="b")
    assert some.totals().poses.sum() == 30  # refused before any of it was counted
    with pytest.raises(PoseDataError, match=r"^sequence: missing in these poses; expected one of prepared, such as a"):
        evaluation(metrics="rank_tests", prepared=posecal.prepare(data)).update(*batch(arrays, 0, 30))


# --- what batches may lack ------------------------------------------------------------------------------------


@pytest.mark.parametrize("left_out", [[9, 13, *range(14, 28), 29, 30, 41], range(14, 28), range(20, 30), range(30, 60)])
@pytest.mark.parametrize("size", [7, 10, 30])
def test_no_velocity_reaches_over_poses_that_are_left_out(arrays: Arrays, size: int, left_out: Sequence[int]) -> None:
    flags = np.array(["yes"] * M)
    flags[list(left_out)] = "no"
    names = ["mpjve", "acceleration_error", "jitter", "mpjpe"]
    protocol = posecal.Protocol(frames="good", metrics=names)
    labels = {"sequence": np.array(["a"] * M), "good": flags}
    one = posecal.evaluate(*arrays, unit="mm", axes="NMKD", labels=labels, protocol=protocol)
    some = evaluation(protocol=protocol)
    for start in range(0, M, size):
        stop = start + size
        part: dict[str, Any] = {name: values[start:stop] for name, values in labels.items()}
        some.update(*batch(arrays, start, stop), **part)
    report = some.compute()
    assert report.totals.poses.tolist() == one.totals.poses.tolist()
    for name in names:
        assert report[name] == pytest.approx(one[name], rel=1e-12)


def test_a_sequence_whose_poses_were_all_dropped_is_not_reported(arrays: Arrays) -> None:
    def rank(rows: npt.NDArray[np.intp]) -> posecal.Evaluation:
        one = evaluation()
        one.update(arrays[0][:, rows], arrays[1][rows], sequence=(rows // 15).astype(str), frame_id=rows)
        return one

    first, second = rank(np.arange(0, 40)), rank(np.arange(30, 60))
    first.merge(second)
    assert first.totals().poses.sum() == M
    assert first.totals().n_sequences == 4
    third = rank(np.arange(45, 60))
    third.merge(rank(np.arange(40, 60)))
    assert (third.totals().poses > 0).all()


def no_joint(rows: slice) -> dict[str, Any]:
    return {"where": np.broadcast_to(np.arange(M)[rows, None] >= 20, (len(range(M)[rows]), K))}


def none_flagged(rows: slice) -> dict[str, Any]:
    return {"good": np.where(np.arange(M)[rows] >= 20, "yes", "no")}


def none_occluded(rows: slice) -> dict[str, Any]:
    return {"occluded": np.broadcast_to(np.arange(M)[rows, None] >= 20, (len(range(M)[rows]), K))}


@pytest.mark.parametrize(
    ("extra", "protocol", "message"),
    [
        (no_joint, posecal.Protocol(), r"^where: no joint of truth counts"),
        (none_flagged, posecal.Protocol(frames="good"), r"^frames: no pose of truth has the label good"),
        (none_occluded, posecal.Protocol(where="occluded"), r"^where: no joint of truth is occluded"),
    ],
)
@pytest.mark.parametrize("starts", [(0, 20, 40), (20, 0, 40), (20, 40, 0)])
def test_a_batch_in_which_nothing_counts_is_no_error(
    arrays: Arrays,
    extra: Callable[[slice], dict[str, Any]],
    protocol: posecal.Protocol,
    message: str,
    starts: tuple[int, ...],
) -> None:
    some = evaluation(protocol=protocol)
    for number, start in enumerate(starts):
        some.update(*batch(arrays, start, start + 20), **extra(slice(start, start + 20)))
        if number == start == 0:
            with pytest.raises(PoseDataError, match=message):
                some.compute()
    given = extra(slice(0, M))
    labels: dict[str, Any] = {"labels": {"good": given.pop("good")}} if "good" in given else {}
    one = posecal.evaluate(*arrays, unit="mm", axes="NMKD", protocol=protocol, **given, **labels)
    assert some.compute().totals.poses.sum() == one.totals.poses.sum()
    assert some.compute()["mpjpe"] == pytest.approx(one["mpjpe"], rel=1e-12)


@pytest.mark.parametrize("where", ["all", "occluded"])
def test_of_all_poses_some_must_count(arrays: Arrays, where: str) -> None:
    none = np.zeros((M, K), dtype=bool)
    data = posecal.PoseData(*arrays, unit="mm", **({"where": none} if where == "all" else {"occluded": none}))
    some = evaluation(protocol=posecal.Protocol(where=where))  # type: ignore[arg-type]
    with pytest.raises(PoseDataError, match=r"^where: no joint of truth (counts|is occluded); expected some to score"):
        some.add(data, complete=True)
    with pytest.raises(PoseDataError, match=r"^evaluation: no batch so far"):
        some.compute()


def test_a_batch_of_one_frame_may_have_its_name_alone(arrays: Arrays) -> None:
    some = evaluation()
    for frame, name in ((0, "a"), (1, ["b"]), (0, "a")):
        some.update(*batch(arrays, frame, frame + 1), frame_id=name)
    assert some.totals().poses.sum() == 2


def test_labels_may_come_in_any_order(arrays: Arrays) -> None:
    some = evaluation()
    some.update(*batch(arrays, 0, 30), sequence="a", action="walk")
    some.update(*batch(arrays, 30, 60), action="sit", sequence="b")
    cells = some.totals().cells
    assert {name: values.tolist() for name, values in cells.items()} == {
        "sequence": ["a", "b"],
        "action": ["walk", "sit"],
    }


def test_a_last_batch_of_as_many_poses_as_hypotheses_keeps_the_layout(arrays: Arrays) -> None:
    some = posecal.Evaluation(unit="mm")
    with pytest.raises(PoseDataError, match="don't tell the axes apart"):
        some.update(*batch(arrays, 0, N))
    some.update(*batch(arrays, 0, M - N))
    some.update(*batch(arrays, M - N, M))
    assert some.compute()["mpjpe"] == posecal.evaluate(*arrays, unit="mm")["mpjpe"]


def test_frame_ids_may_come_after_a_merge(arrays: Arrays) -> None:
    first, second = evaluation(), evaluation()
    second.update(*batch(arrays, 0, 30), frame_id=np.arange(30))
    first.merge(second)
    with pytest.raises(PoseDataError, match=r"^frame_id: missing in this batch"):
        first.update(*batch(arrays, 30, 60))
    first.update(*batch(arrays, 20, 60), frame_id=np.arange(20, 60))
    assert first.totals().poses.sum() == M


def test_pending_frames_are_those_that_count(arrays: Arrays) -> None:
    """Of frames that ``frames`` leaves out none is pending."""
    flags = np.where(np.arange(M) % 3 == 1, "no", "yes")

    def rank(rows: npt.NDArray[np.intp]) -> posecal.Evaluation:
        one = evaluation(protocol=posecal.Protocol(frames="good"))
        one.update(arrays[0][:, rows], arrays[1][rows], sequence=rows.astype(str), good=flags[rows], frame_id=rows)
        return one

    first = rank(np.arange(0, 35))
    first.merge(rank(np.arange(25, 60)))
    assert sorted(map(int, first.totals().cells["sequence"])) == np.flatnonzero(flags == "yes").tolist()
